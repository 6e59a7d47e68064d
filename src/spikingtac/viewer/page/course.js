// The displacement of all markers over the whole course, kept as it was drawn.
import { niceStep, numberLabel } from "./charts.js";
import { colors, fitCanvas } from "./theme.js";

const BUCKET_US = 16_000; // about a frame
const MOST_FLOATS = 8 << 20; // 32 MiB; beyond it every other sample goes
const GAP_US = 400_000; // samples further apart are not joined
const LEFT = 34, BOTTOM = 16; // px for the labels
const FIRST_SPAN_US = 10e6; // axis of a source whose length is not known; it doubles

export class Course {
  constructor(canvas) {
    this.canvas = canvas;
    this.cache = document.createElement("canvas");
    this.clear();
  }

  clear() {
    this.samples = new Map(); // bucket -> { t_us, moved: [dx0, dy0, dx1, ...] }
    this.bucketUs = BUCKET_US;
    this.top = 1;
    this.painted = "";
    this.newest = undefined;
    this.fresh = []; // pairs of samples that are not painted yet
  }

  // Keep a frame's displacements; true where they are the largest so far.
  add(tUs, startUs, position, reference) {
    const moved = new Float32Array(position.length);
    for (let i = 0; i < position.length; i++) moved[i] = position[i] - reference[i >> 1][i & 1];
    const bucket = Math.floor((tUs - startUs) / this.bucketUs), last = this.samples.get(bucket);
    if (last && last.t_us === tUs) return;
    this.samples.set(bucket, { t_us: tUs, moved });
    let largest = 0;
    for (let i = 0; i < moved.length; i += 2) largest = Math.max(largest, Math.hypot(moved[i], moved[i + 1]));
    while (largest > this.top) [this.top, this.painted] = [nextNice(this.top), ""];
    if (this.samples.size * moved.length > MOST_FLOATS) this.thin(startUs);
    const since = tUs - (this.newest?.t_us ?? -Infinity);
    const before = since > 0 && since <= GAP_US ? this.newest : this.samples.get(bucket - 1);
    this.newest = this.samples.get(bucket);
    if (before) this.fresh.push([before, this.newest]);
  }

  thin(startUs) {
    this.bucketUs *= 2;
    const kept = [...this.samples.values()].map((s) => [Math.floor((s.t_us - startUs) / this.bucketUs), s]);
    this.samples = new Map(kept);
  }

  inOrder() {
    return [...this.samples.values()].sort((a, b) => a.t_us - b.t_us);
  }

  // The chosen marker's samples of a stretch, oldest first.
  of(marker, fromUs, toUs) {
    return this.inOrder().filter((s) => s.t_us >= fromUs && s.t_us <= toUs)
      .map((s) => ({ t_us: s.t_us, dx: s.moved[2 * marker], dy: s.moved[2 * marker + 1] }));
  }

  draw(meta, marker, ends) {
    fitCanvas(this.canvas);
    const { width, height } = this.canvas, tone = colors();
    this.startUs = meta.t_start_us;
    const lasts = Math.max(meta.t_end_us - meta.t_start_us, 1);
    let span = FIRST_SPAN_US;
    while (span < lasts) span *= 2;
    this.spanUs = ends ? lasts : span;
    const wanted = [width, height, this.top, this.spanUs, tone.ground, this.bucketUs].join();
    if (wanted !== this.painted) this.paintAll(tone, wanted);
    else if (this.fresh.length) this.paint(this.cache.getContext("2d"), this.fresh, tone);
    this.fresh = [];
    const context = this.canvas.getContext("2d");
    context.clearRect(0, 0, width, height);
    context.drawImage(this.cache, 0, 0);
    this.chosen(context, marker, tone);
    context.fillStyle = tone.text;
    context.fillRect(this.x(meta.t_us) - devicePixelRatio, 0, 2 * devicePixelRatio, height - BOTTOM * devicePixelRatio);
  }

  x(tUs) {
    const left = LEFT * devicePixelRatio;
    return left + (this.canvas.width - left) * (tUs - this.startUs) / this.spanUs;
  }

  y(moved) {
    const floor = this.canvas.height - BOTTOM * devicePixelRatio, edge = 4 * devicePixelRatio;
    return floor - (floor - edge) * moved / this.top;
  }

  paintAll(tone, wanted) {
    this.painted = wanted;
    [this.cache.width, this.cache.height] = [this.canvas.width, this.canvas.height];
    const context = this.cache.getContext("2d");
    this.axes(context, tone);
    this.paint(context, [this.inOrder()], tone);
  }

  paint(context, runs, tone) {
    context.strokeStyle = tone.edge;
    context.globalAlpha = 0.5;
    context.lineWidth = devicePixelRatio;
    context.beginPath();
    for (const samples of runs) {
      for (let at = 0; at < (samples[0]?.moved.length ?? 0); at += 2) this.path(context, samples, at);
    }
    context.stroke();
    context.globalAlpha = 1;
  }

  path(context, samples, at) {
    let last = -Infinity;
    for (const { t_us: tUs, moved } of samples) {
      const place = [this.x(tUs), this.y(Math.hypot(moved[at], moved[at + 1]))];
      if (tUs - last > GAP_US) context.moveTo(...place);
      else context.lineTo(...place);
      last = tUs;
    }
  }

  chosen(context, marker, tone) {
    if (this.ordered !== this.samples.size || this.orderedOf !== this.samples) {
      [this.ordered, this.orderedOf, this.sorted] = [this.samples.size, this.samples, this.inOrder()];
    }
    context.strokeStyle = tone.arrow;
    context.lineWidth = 2.5 * devicePixelRatio;
    context.lineJoin = "round";
    context.beginPath();
    this.path(context, this.sorted, 2 * marker);
    context.stroke();
  }

  axes(context, tone) {
    const ratio = devicePixelRatio, { width, height } = this.cache, floor = height - BOTTOM * ratio;
    context.clearRect(0, 0, width, height);
    context.font = `${11 * ratio}px system-ui, sans-serif`;
    context.fillStyle = tone.soft;
    context.strokeStyle = tone.line;
    context.lineWidth = ratio;
    [context.textAlign, context.textBaseline] = ["right", "middle"];
    const step = niceStep(this.top);
    for (let value = 0; value <= this.top; value += step) {
      line(context, LEFT * ratio, this.y(value), width, this.y(value));
      if (this.y(value) > 6 * ratio) context.fillText(numberLabel(value), (LEFT - 6) * ratio, Math.min(this.y(value), floor - 2 * ratio));
    }
    [context.textAlign, context.textBaseline] = ["center", "bottom"];
    const seconds = this.spanUs / 1e6, tick = niceStep(seconds);
    for (let at = 0; at <= seconds; at += tick) {
      const x = this.x(this.startUs + at * 1e6);
      if (x < width - 14 * ratio) context.fillText(`${numberLabel(at)} s`, Math.max(x, (LEFT + 8) * ratio), height);
    }
  }
}

function line(context, x0, y0, x1, y1) {
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}

export function nextNice(value) {
  const base = 10 ** Math.floor(Math.log10(value) + 1e-9);
  return [1.5, 2, 3, 4, 5, 6, 8, 10].map((factor) => factor * base).find((step) => step > value * 1.001);
}
