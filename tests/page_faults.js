/* What is wrong with where words stand on a page, in its elements and on its canvases. */
() => {
  const SLACK = 2, faults = [], texts = [];
  const covers = (a, b) => Math.min(a[2], b[2]) - Math.max(a[0], b[0]) > SLACK && Math.min(a[3], b[3]) - Math.max(a[1], b[1]) > SLACK;
  const short = (t) => t.trim().replace(/\s+/g, " ").slice(0, 60);
  const hides = (e) => /hidden|clip|auto|scroll/.test(getComputedStyle(e).overflowX) || /hidden|clip|auto|scroll/.test(getComputedStyle(e).overflowY);
  const told = (e) => !!e.closest("[title], [aria-label]") || !!e.closest("[data-whole]");
  const skip = "script, style, noscript, template, svg, .q-tooltip, .q-notification, .visually-hidden, [aria-hidden=true], .q-icon, i";
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const e = node.parentElement;
    if (!node.data.trim() || e.closest(skip)) continue;
    if (!e.checkVisibility({ opacityProperty: true, visibilityProperty: true })) continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    for (const r of range.getClientRects()) {
      if (r.width < 1 || r.height < 1) continue;
      let box = [r.left + scrollX, r.top + scrollY + 2, r.right + scrollX, r.bottom + scrollY - 2], scrolls = false;
      for (let up = e; up && up !== document.documentElement; up = up.parentElement) {
        if (!hides(up)) continue;
        const style = getComputedStyle(up), b = up.getBoundingClientRect(), edge = [b.left + scrollX, b.top + scrollY, b.right + scrollX, b.bottom + scrollY];
        scrolls ||= /auto|scroll/.test(style.overflowX + style.overflowY);
        const out = box[2] > edge[2] + SLACK || box[0] < edge[0] - SLACK || box[3] > edge[3] + SLACK || box[1] < edge[1] - SLACK;
        if (out && !scrolls && !(style.textOverflow === "ellipsis" && told(up))) faults.push(`cut: '${short(node.data)}'`);
        box = [Math.max(box[0], edge[0]), Math.max(box[1], edge[1]), Math.min(box[2], edge[2]), Math.min(box[3], edge[3])];
      }
      if (box[2] - box[0] < 1 || box[3] - box[1] < 1) continue;
      const fixed = !!e.closest("header.uq-header");
      if (!fixed && (box[0] < -SLACK || box[2] > document.documentElement.scrollWidth + SLACK)) faults.push(`beyond the page: '${short(node.data)}'`);
      texts.push([short(node.data), box, node, fixed]);
    }
  }
  for (const i of document.querySelectorAll("input, textarea")) {
    if (!i.checkVisibility({ opacityProperty: true, visibilityProperty: true }) || !/^(text|search|number|)$/.test(i.type)) continue;
    const shown = i.value || i.placeholder, pen = document.createElement("canvas").getContext("2d"), style = getComputedStyle(i);
    if (!shown || i.matches(".q-select__focus-target")) continue;
    pen.font = style.font;
    const room = i.clientWidth - parseFloat(style.paddingLeft) - parseFloat(style.paddingRight);
    if (pen.measureText(shown).width > room + SLACK && !told(i)) faults.push(`cut in its field: '${shown}'`);
  }
  for (const canvas of document.querySelectorAll("canvas")) {
    if (!canvas.words || !canvas.checkVisibility()) continue;
    const frame = canvas.getBoundingClientRect(), scale = frame.width / canvas.width;
    if (!frame.width) continue;
    const words = canvas.words.map(([t, b]) => [t, [frame.left + scrollX + b[0] * scale, frame.top + scrollY + b[1] * scale, frame.left + scrollX + b[2] * scale, frame.top + scrollY + b[3] * scale]]);
    const edge = [frame.left + scrollX, frame.top + scrollY, frame.right + scrollX, frame.bottom + scrollY];
    for (const [t, b] of words) {
      if (b[0] < edge[0] - SLACK || b[1] < edge[1] - SLACK || b[2] > edge[2] + SLACK || b[3] > edge[3] + SLACK) faults.push(`beyond its figure: '${t}'`);
      texts.push([t, b, canvas, false]);
    }
    const near = (a, b) => Math.min(a[2], b[2]) - Math.max(a[0], b[0]) > -3 && Math.min(a[3], b[3]) - Math.max(a[1], b[1]) > SLACK;
    for (let j = 0; j < words.length; j++) for (let k = 0; k < j; k++)
      if (near(words[j][1], words[k][1])) faults.push(`touch in a figure: '${words[k][0]}' and '${words[j][0]}'`);
  }
  for (const box of document.querySelectorAll(".uq-table-box, .wide"))
    if (box.checkVisibility() && box.scrollWidth > box.clientWidth + SLACK) faults.push(`hidden beyond its place: columns of '${short(box.innerText)}'`);
  texts.sort((a, b) => a[1][1] - b[1][1]);
  for (let j = 0; j < texts.length; j++) for (let k = j + 1; k < texts.length && texts[k][1][1] < texts[j][1][3]; k++) {
    const [a, b] = [texts[j], texts[k]];
    if (a[2] === b[2]) continue; // lines of one text, and words of one canvas, which were compared above
    if (a[3] !== b[3]) continue; // what stands fast at the top passes over what is scrolled
    if (covers(a[1], b[1])) faults.push(`overlap: '${a[0]}' and '${b[0]}'`);
  }
  return { faults: [...new Set(faults)], texts: texts.length };
}
