/* Notes each text that is drawn on a canvas, where, until the canvas is cleared: runs before a page's own scripts. */
(() => {
  const P = CanvasRenderingContext2D.prototype, draw = P.fillText, clear = P.clearRect;
  P.fillText = function (text, x, y) {
    const m = this.getTransform(), s = this.measureText(text), from = { center: 0.5, right: 1, end: 1 }[this.textAlign] || 0;
    const [w, up, down] = [s.width, s.actualBoundingBoxAscent, s.actualBoundingBoxDescent];
    const corners = [[-from * w, -up], [(1 - from) * w, -up], [-from * w, down], [(1 - from) * w, down]];
    const seen = corners.map(([a, b]) => m.transformPoint(new DOMPoint(x + a, y + b)));
    const box = [Math.min(...seen.map((p) => p.x)), Math.min(...seen.map((p) => p.y)), Math.max(...seen.map((p) => p.x)), Math.max(...seen.map((p) => p.y))];
    if (String(text).trim() && w) (this.canvas.words ??= []).push([String(text), box]);
    return draw.apply(this, arguments);
  };
  P.clearRect = function (x, y, w, h) {
    if (x <= 0 && y <= 0 && w >= this.canvas.width && h >= this.canvas.height) this.canvas.words = [];
    return clear.apply(this, arguments);
  };
})()
