// The other recordings of the folder, where the command offers them: on this machine only.
const $ = (id) => document.getElementById(id);

export function showShelf({ shelf, opened }, open) {
  $("open").hidden = !shelf;
  if (!shelf) return;
  const wanted = JSON.stringify([shelf, opened]), list = $("shelf-names");
  if (list.dataset.shown === wanted) return;
  list.dataset.shown = wanted;
  list.replaceChildren(...shelf.map((name) => {
    const entry = document.createElement("li"), button = document.createElement("button");
    button.textContent = name;
    button.className = "quiet";
    if (name === opened) button.setAttribute("aria-current", "true");
    button.addEventListener("click", () => { $("shelf").close(); if (name !== opened) open(name); });
    entry.append(button);
    return entry;
  }));
}
