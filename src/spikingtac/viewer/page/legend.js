// The legend: what is drawn, and nothing else.
import { length } from "./readings.js";

const TEXTS = {
  on: ["became brighter", "The latest event of the pixel says that it became brighter (ON)."],
  off: ["became darker", "The latest event of the pixel says that it became darker (OFF)."],
  bright: ["bright", "What the tracker believes the pixel shows; a marker is bright."],
  rest: ["marker at rest", "Where each marker is without load, from the calibration."],
  truth: ["truth", "Where the simulated marker really is."],
  held: ["held", "The marker is not seen; its neighbours and its past say where it should be."],
  lost: ["lost", "The marker was not seen for long; its arrow says nothing."],
  mesh: ["grid", "Each marker joined with its neighbours, exaggerated like the arrows."],
  chosen: ["chosen marker", "The one whose displacement is drawn beside the sensor."],
  patch: ["touched", "Outline of the part of the skin that something touches."],
  force: ["force along the skin", "Longer is stronger."],
  "guide-todo": ["has to move on", "The ring closes with the share of the marker that has been seen; the tip points where to slide."],
  "guide-enough": ["has moved enough", "The calibration can learn this marker."],
};

export function legendKeys(options, hello, meta, arrays) {
  const keys = [], markers = hello.reference_px.length > 0;
  if (["surface", "events"].includes(options.image)) keys.push("on", "off");
  if (options.image === "map") keys.push("bright");
  if (arrays.guide_px) keys.push("guide-todo", "guide-enough");
  if (!markers) return keys;
  if (options.discs) keys.push("rest");
  if (options.truth && arrays.truth_px) keys.push("truth");
  if (options.mesh) keys.push("mesh");
  if (options.arrows) {
    const sustained = arrays.held?.some((held, i) => held && arrays.confidence[i] > 0), lost = arrays.held?.some((held, i) => held && arrays.confidence[i] === 0);
    if (sustained) keys.push("held");
    if (lost) keys.push("lost");
  }
  keys.push("chosen");
  if (meta.felt?.outline_px?.length) keys.push("patch");
  if (meta.felt?.force_n) keys.push("force");
  return keys;
}

export function showLegend(list, keys, scale) {
  const wanted = JSON.stringify([keys, scale]);
  if (list.dataset.shown === wanted) return;
  list.dataset.shown = wanted;
  list.replaceChildren(...keys.map((key) => item(`key key-${key}`, ...TEXTS[key])));
  if (scale) {
    const bar = item("bar", "", "Colour of arrows and heat map: how far the marker has moved.");
    bar.prepend(text("0 "));
    bar.append(text(length(scale.top, scale.pxPerMm)));
    list.append(bar);
  }
}

function item(kind, said, about) {
  const entry = document.createElement("li"), mark = document.createElement("i");
  mark.className = kind;
  mark.setAttribute("aria-hidden", "true");
  entry.append(mark, text(said));
  entry.title = about;
  return entry;
}

function text(said) {
  return document.createTextNode(said);
}
