// Keys work wherever the focus is. A control that was reached by the keyboard keeps the keys that
// it needs itself; one that was clicked does not. (:focus-visible does not tell them apart: a key
// pressed after the click makes it true.)
const OF_RANGES = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End"];

let clicked = false;

export function listen(actions) {
  document.addEventListener("pointerdown", () => { clicked = true; }, true);
  document.addEventListener("keydown", (event) => { if (event.key === "Tab") clicked = false; }, true);
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !actions[event.key] || needed(event.target, event.key)) return;
    event.preventDefault();
    actions[event.key](event.shiftKey);
  });
}

function needed(target, key) {
  if (target.closest("dialog")) return true;
  if (clicked || target.id === "timeline") return false;
  if (target.matches("select")) return key !== "?";
  if (target.matches("input[type=range]")) return OF_RANGES.includes(key);
  return target.matches("button, summary, input[type=checkbox]") && key === " ";
}
