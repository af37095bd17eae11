/* A figure of ultraquiet/chart in a page: fetches its frame, draws it, draws the next one in the same place. */
function unpacked(buffer) {
  const head = new DataView(buffer).getUint32(0, true);
  const { spec, arrays } = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, head)));
  let at = 4 + head;
  spec.data = {};
  for (const [name, count] of arrays) {
    spec.data[name] = new Float32Array(buffer, at, count);
    at += 4 * count;
  }
  return spec;
}
export default {
  template: `<div class="uq-host"><div ref="place"></div><div ref="caption" class="uq-words caption"></div></div>`,
  props: { frame: String },
  data: () => ({ busy: false, next: null }),
  mounted() { this.$el.uqShow = (name) => this.show(name); this.show(this.frame); },
  beforeUnmount() { this.figure?.destroy(); },
  watch: { frame(name) { this.show(name); } },
  methods: {
    async show(name) {
      if (!name) return;
      if (this.busy) { this.next = name; return; } // only the latest is worth drawing
      this.busy = true;
      try {
        const answer = await fetch(`/frames/${name}`);
        if (answer.ok && this.$refs.place) {
          const spec = unpacked(await answer.arrayBuffer());
          if (this.figure && !!spec.shapes === !!this.figure.shapes) this.figure.update(spec);
          else this.begin(spec);
          this.$refs.caption.textContent = spec.caption || "";
          this.$el.dataset.drawn = name;
          this.$el.dispatchEvent(new CustomEvent("uq-drawn", { bubbles: true, detail: name }));
        }
      } finally {
        this.busy = false;
        const next = this.next;
        this.next = null;
        if (next) this.show(next);
      }
    },
    begin(spec) {
      this.figure?.destroy();
      this.figure = (spec.shapes ? Uq.scene : Uq.grid)(this.$refs.place, spec);
      this.$refs.place.addEventListener("uq-zoom", (e) => this.$emit("zoom", e.detail));
      this.$refs.place.addEventListener("uq-click", (e) => this.$emit("point", e.detail));
    },
  },
};
