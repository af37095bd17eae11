(() => {
  "use strict";
  const root = document.documentElement, specs = document.getElementById("uq-specs");
  if (specs) {
    Uq.data(JSON.parse(document.getElementById("uq-data").textContent));
    const all = JSON.parse(specs.textContent);
    document.querySelectorAll("[data-chart]").forEach((place) => (place.chart = (all[place.dataset.chart].shapes ? Uq.scene : Uq.grid)(place, all[place.dataset.chart])));
  }
  const dark = () => (root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches);
  document.getElementById("theme").onclick = () => (root.dataset.theme = dark() ? "light" : "dark");

  /* A click on a head sorts by that column, numbers by size, a second click the other way round. */
  const number = (text) => parseFloat(text.replace("\u2212", "-"));
  document.querySelectorAll("table.sortable").forEach((table) => {
    const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
    heads.forEach((head, k) => {
      head.tabIndex = 0;
      const sort = () => {
        const down = head.getAttribute("aria-sort") === "ascending";
        const key = (row) => (row.cells[k] ? row.cells[k].textContent.trim() : "");
        const rows = [...body.rows];
        rows.sort((a, b) => {
          const [x, y] = [number(key(a)), number(key(b))];
          const order = Number.isNaN(x) || Number.isNaN(y) ? (Number.isNaN(x) - Number.isNaN(y)) || key(a).localeCompare(key(b)) : x - y;
          return down ? -order : order;
        });
        heads.forEach((h) => h.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        body.append(...rows);
      };
      head.onclick = sort;
      head.onkeydown = (e) => e.key === "Enter" && sort();
    });
  });
  addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((d) => { d.dataset.was = d.open ? "1" : ""; d.open = true; }));
  addEventListener("afterprint", () => document.querySelectorAll("details").forEach((d) => (d.open = !!d.dataset.was)));
})();
