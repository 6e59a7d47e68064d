// Two strips over the same time axis with its seconds, and the timeline's overview.
import { colors, fitCanvas } from "./theme.js";

const STRIP_S = 2;
const LEFT = 34, BOTTOM = 16; // px for the axis labels
const KEPT_WINDOWS = 4096;

export class Counts {
  constructor(canvas) {
    this.canvas = canvas;
    this.clear();
  }

  clear() {
    this.values = new Map();
    this.last = -1;
  }

  add(meta, counts) {
    const first = meta.last_window - counts.length + 1, back = meta.last_window < this.last;
    for (let i = back ? 0 : Math.max(0, this.last + 1 - first); i < counts.length; i++) {
      this.values.delete(first + i); // the oldest in the map goes first
      this.values.set(first + i, counts[i]);
    }
    this.last = meta.last_window;
    for (const key of this.values.keys()) {
      if (this.values.size <= KEPT_WINDOWS) break;
      this.values.delete(key);
    }
  }

  draw(meta, windowUs) {
    const strip = new Strip(this.canvas, meta.t_us);
    const threshold = meta.contact?.threshold;
    const shown = STRIP_S * 1e6 / windowUs;
    let top = 10;
    for (let i = Math.max(0, this.last - shown); i <= this.last; i++) top = Math.max(top, this.values.get(i) ?? 0);
    strip.range(0, top * 1.1);
    const points = [];
    for (let i = Math.max(0, this.last - shown); i <= this.last; i++) {
      if (this.values.has(i)) points.push([meta.t_start_us + (i + 1) * windowUs, this.values.get(i)]);
    }
    if (threshold !== undefined && threshold < top) strip.level(threshold, strip.tone.contact);
    for (const at of meta.contacts_us) strip.mark(at, strip.tone.contact);
    strip.columns(points, strip.tone.on);
    strip.seconds(meta.t_start_us);
    return this.values.get(this.last);
  }
}

export class Trace {
  constructor(canvas) {
    this.canvas = canvas;
    this.clear();
  }

  clear() {
    this.samples = [];
  }

  add(sample) {
    const last = this.samples.at(-1);
    if (last && sample.t_us < last.t_us) this.clear();
    if (!last || sample.t_us !== last.t_us) this.samples.push(sample);
    while (this.samples.length && this.samples[0].t_us < sample.t_us - STRIP_S * 1e6) this.samples.shift();
  }

  // What is known of another marker, so that its panel is filled at once.
  fill(samples) {
    this.samples = samples;
  }

  draw(meta, withTruth) {
    const strip = new Strip(this.canvas, meta.t_us);
    const all = this.samples.flatMap(({ dx, dy }) => [dx, dy]);
    const reach = Math.max(2, ...all.map(Math.abs)) * 1.15;
    strip.range(-reach, reach);
    strip.level(0, strip.tone.line);
    for (const at of meta.contacts_us) strip.mark(at, strip.tone.contact);
    const series = (key) => this.samples.filter((s) => s[key] !== undefined).map((s) => [s.t_us, s[key]]);
    if (withTruth) for (const key of ["truthX", "truthY"]) strip.line(series(key), strip.tone.truth, 1);
    strip.line(series("dx"), strip.tone.arrow);
    strip.line(series("dy"), strip.tone.on);
    strip.seconds(meta.t_start_us);
  }
}

class Strip {
  constructor(canvas, nowUs) {
    fitCanvas(canvas);
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.ratio = devicePixelRatio;
    this.tone = colors();
    this.nowUs = nowUs;
    this.context.clearRect(0, 0, canvas.width, canvas.height);
    this.context.font = `${11 * this.ratio}px system-ui, sans-serif`;
    this.floor = canvas.height - BOTTOM * this.ratio;
  }

  seconds(startUs) {
    const context = this.context, now = (this.nowUs - startUs) / 1e6;
    context.fillStyle = this.tone.soft;
    [context.textAlign, context.textBaseline] = ["center", "bottom"];
    for (let at = Math.ceil((now - STRIP_S) * 2) / 2; at <= now; at += 0.5) {
      const x = this.x(startUs + at * 1e6);
      if (at >= 0 && x > (LEFT + 12) * this.ratio && x < this.canvas.width - 16 * this.ratio) context.fillText(`${at.toFixed(1)} s`, x, this.canvas.height);
    }
  }

  x(tUs) {
    const left = LEFT * this.ratio;
    return left + (this.canvas.width - left) * (1 - (this.nowUs - tUs) / (STRIP_S * 1e6));
  }

  y(value) {
    const edge = 4 * this.ratio;
    return edge + (this.floor - 2 * edge) * (this.high - value) / (this.high - this.low);
  }

  range(low, high) {
    [this.low, this.high] = [low, high];
    const context = this.context;
    context.fillStyle = this.tone.soft;
    context.textAlign = "right";
    context.textBaseline = "middle";
    const step = niceStep(high - low);
    for (let value = Math.ceil(low / step) * step; value <= high; value += step) {
      if (Math.abs(this.y(value) - this.floor / 2) > this.floor / 2 - 6 * this.ratio) continue;
      context.fillText(numberLabel(value), (LEFT - 6) * this.ratio, this.y(value));
    }
  }

  level(value, color) {
    this.stroke(color, 1, () => {
      this.context.moveTo(LEFT * this.ratio, this.y(value));
      this.context.lineTo(this.canvas.width, this.y(value));
    });
  }

  mark(tUs, color) {
    if (this.x(tUs) < LEFT * this.ratio) return;
    this.stroke(color, 1, () => {
      this.context.moveTo(this.x(tUs), 0);
      this.context.lineTo(this.x(tUs), this.floor);
    });
  }

  line(points, color, width = 1.4) {
    this.stroke(color, width, () => {
      for (const [tUs, value] of points) {
        if (this.x(tUs) >= LEFT * this.ratio) this.context.lineTo(this.x(tUs), this.y(value));
      }
    });
  }

  // Many points to a pixel, from the lowest to the highest of each column: a line through all of
  // them looks the same, and costs more than the whole sensor.
  columns(points, color) {
    const context = this.context, thick = Math.round(1.4 * this.ratio);
    let column, low, high, last;
    const fill = () => column >= LEFT * this.ratio && context.fillRect(column, low, this.ratio, Math.max(high - low, thick));
    context.fillStyle = color;
    for (const [tUs, value] of points) {
      const x = Math.round(this.x(tUs)), y = this.y(value);
      if (x !== column) {
        if (column !== undefined) fill();
        [column, low, high] = [x, Math.min(y, last ?? y), Math.max(y, last ?? y)]; // joined with the one before
      }
      [low, high, last] = [Math.min(low, y), Math.max(high, y), y];
    }
    if (column !== undefined) fill();
  }

  stroke(color, width, path) {
    this.context.strokeStyle = color;
    this.context.lineWidth = width * this.ratio;
    this.context.lineJoin = "round";
    this.context.beginPath();
    path();
    this.context.stroke();
  }
}

// The timeline's overview: bars that change rarely, drawn once in two colours, and what is played.
export class Overview {
  constructor(canvas) {
    this.canvas = canvas;
    [this.played, this.ahead] = [0, 1].map(() => document.createElement("canvas"));
  }

  draw(overview, meta) {
    fitCanvas(this.canvas);
    const { width, height } = this.canvas, tone = colors(), ratio = devicePixelRatio;
    const start = meta.t_start_us, span = Math.max(meta.t_end_us - start, 1);
    const across = (tUs) => Math.round(((tUs - start) / span) * width);
    const head = across(meta.t_us), marks = meta.contacts_us.map(across);
    const bars = [width, height, span, tone.soft].join();
    if (this.bars !== bars || this.of !== overview) {
      [this.bars, this.of, this.shown] = [bars, overview, ""];
      drawBars(this.played, this.canvas, overview, span, tone.soft);
      drawBars(this.ahead, this.canvas, overview, span, tone.line);
    }
    const shown = [head, ...marks].join();
    if (this.shown === shown) return;
    this.shown = shown;
    const context = this.canvas.getContext("2d");
    context.clearRect(0, 0, width, height);
    if (head > 0) context.drawImage(this.played, 0, 0, head, height, 0, 0, head, height);
    if (head < width) context.drawImage(this.ahead, head, 0, width - head, height, head, 0, width - head, height);
    context.fillStyle = tone.contact;
    for (const at of marks) context.fillRect(at - ratio, 0, 2 * ratio, 4 * ratio);
    context.fillStyle = tone.text;
    context.fillRect(head - ratio, 0, 2 * ratio, height);
  }
}

function drawBars(onto, { width, height }, overview, span, color) {
  [onto.width, onto.height] = [width, height];
  const context = onto.getContext("2d"), ratio = devicePixelRatio;
  const top = Math.max(...overview.counts, 1);
  const bar = (width / overview.counts.length) * (overview.t_end_us - overview.t_start_us) / span;
  context.fillStyle = color;
  overview.counts.forEach((count, index) => {
    const tall = Math.max(ratio, (height - 6 * ratio) * Math.sqrt(count / top));
    context.fillRect(index * bar, height - tall, Math.max(bar - 0.5, 1), tall);
  });
}

export function niceStep(span) {
  const raw = span / 4, base = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].map((factor) => factor * base).find((step) => step >= raw);
}

export function numberLabel(value) {
  if (value === 0) return "0";
  return Math.abs(value) >= 1000 ? `${+(value / 1000).toPrecision(3)}k` : `${+value.toPrecision(3)}`;
}
