/* Keys and themes: what must work without the server's answer. */
async function uqStop() {
  document.documentElement.dataset.stopped = "asked";
  try { await fetch("/stop", { method: "POST" }); document.documentElement.dataset.stopped = "done"; } catch { /* said by the reconnect notice */ }
  setTimeout(() => delete document.documentElement.dataset.stopped, 1500);
}
function uqDark() {
  const word = localStorage.getItem("uq-theme");
  return word ? word === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}
function uqApply() {
  const dark = uqDark();
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  if (window.Quasar) Quasar.Dark.set(dark);
}
function uqTheme() {
  localStorage.setItem("uq-theme", uqDark() ? "light" : "dark");
  uqApply();
}
document.documentElement.dataset.theme = uqDark() ? "dark" : "light";
addEventListener("load", uqApply);
if (location.search.includes("token=")) {
  const kept = new URLSearchParams(location.search);
  kept.delete("token");
  history.replaceState(null, "", location.pathname + (kept.size ? "?" + kept : ""));
}
let uqEscaped = 0;
addEventListener("keydown", (e) => {
  if (e.key === "Escape") {
    const now = performance.now();
    if (now - uqEscaped < 800) uqStop();
    uqEscaped = now;
    return;
  }
  const typing = /^(input|textarea|select)$/i.test(e.target.tagName) || e.target.isContentEditable;
  if (typing) return;
  const key = e.key.toLowerCase();
  const say = (word) => { window.emitEvent && emitEvent("uq-key", word); e.preventDefault(); e.stopImmediatePropagation(); };
  if ((e.ctrlKey || e.metaKey) && key === "z") return say(e.shiftKey ? "redo" : "undo");
  if (e.ctrlKey || e.metaKey || e.altKey) return;
  if (key === "h" || (key === "d" && !document.querySelector(".uq:hover"))) say(key);
}, true);
