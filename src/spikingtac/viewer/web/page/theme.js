// Colours come from the style sheet, so that canvases and text change together.
const NAMES = ["ground", "panel", "line", "text", "soft", "arrow", "held", "lost", "truth", "on", "off", "contact", "image", "disc"];
const ORDER = { auto: "dark", dark: "light", light: "auto" };

export function colors() {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

export function startTheme(changed) {
  const root = document.documentElement;
  root.dataset.theme = localStorage.getItem("theme") ?? "auto";
  matchMedia("(prefers-color-scheme: light)").addEventListener("change", changed);
  return () => {
    const light = getComputedStyle(root).colorScheme === "light";
    root.dataset.theme = root.dataset.theme === "auto" ? (light ? "dark" : "light") : ORDER[root.dataset.theme];
    if (root.dataset.theme === "auto") root.dataset.theme = "dark";
    localStorage.setItem("theme", root.dataset.theme);
    changed();
  };
}

export function fitCanvas(canvas) {
  const width = Math.round(canvas.clientWidth * devicePixelRatio);
  const height = Math.round(canvas.clientHeight * devicePixelRatio);
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
}
