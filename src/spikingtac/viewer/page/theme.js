// Colours come from the style sheet, so that canvases and text change together.
const NAMES = [
  "ground", "panel", "line", "text", "soft", "edge", "image", "on", "off", "disc", "mesh", "arrow", "held", "lost", "truth", "contact", "good",
  "force", "scale-0", "scale-1", "scale-2", "scale-3", "scale-4",
];
let known;
const ORDER = { auto: "dark", dark: "light", light: "auto" };

export function colors() {
  if (!known) {
    const style = getComputedStyle(document.documentElement);
    known = Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  }
  return known; // asked for in every frame, and the same until the theme changes
}

export function startTheme(changed) {
  const root = document.documentElement;
  root.dataset.theme = localStorage.getItem("theme") ?? "auto";
  matchMedia("(prefers-color-scheme: light)").addEventListener("change", () => { known = null; changed(); });
  return () => {
    const light = getComputedStyle(root).colorScheme === "light";
    root.dataset.theme = root.dataset.theme === "auto" ? (light ? "dark" : "light") : ORDER[root.dataset.theme];
    if (root.dataset.theme === "auto") root.dataset.theme = "dark";
    localStorage.setItem("theme", root.dataset.theme);
    known = null;
    changed();
  };
}

// Sizes are told by the browser when they change: asking for one makes it lay out the page at once.
const sizes = new WeakMap();
let resized = () => {};
const watcher = new ResizeObserver((entries) => {
  for (const { target } of entries) sizes.set(target, [target.clientWidth, target.clientHeight]);
  resized();
});

export function onResize(changed) {
  resized = changed;
}

export function fitCanvas(canvas) {
  if (!sizes.has(canvas)) {
    sizes.set(canvas, [canvas.clientWidth, canvas.clientHeight]);
    watcher.observe(canvas);
  }
  const [width, height] = sizes.get(canvas).map((side) => Math.round(side * devicePixelRatio));
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
}
