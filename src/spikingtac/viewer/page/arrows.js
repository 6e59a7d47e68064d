// Arrows on a canvas: those of one colour are one path, since each path costs as much as its pixels.
const SHAFT_PX = 1.6, DOT_PX = 1.5, CROSS_PX = 4, DASH_PX = [4, 3];
const HEAD_SHARE = 0.35, SMALLEST_HEAD_PX = 2, LONGEST_HEAD_PX = 7;
const HEAD_TURN = 0.42; // half of the angle at the tip, rad
const SHORTEST_PX = 0.35; // below it, in sensor pixels, a dot says more than an arrow

// Markers that are seen: a list of [from, to, displacement] for each colour.
export function drawSeen(context, byColor) {
  for (const [color, arrows] of byColor) {
    context.fillStyle = color;
    context.beginPath();
    for (const [from, to, moved] of arrows) {
      if (moved < SHORTEST_PX) dot(context, to);
      else outline(context, from, to);
    }
    context.fill();
  }
}

// Markers that are not: a dashed line, and a cross where they are lost.
export function drawSustained(context, arrows, tone) {
  const ratio = devicePixelRatio;
  context.lineWidth = SHAFT_PX * ratio;
  for (const [[from, to, moved], lost] of arrows) {
    context.strokeStyle = context.fillStyle = lost ? tone.lost : tone.held;
    if (moved >= SHORTEST_PX) dashed(context, from, headOf(from, to).base);
    context.beginPath();
    if (moved < SHORTEST_PX) dot(context, to);
    else polygon(context, headOf(from, to).corners);
    context.fill();
    if (lost) cross(context, from);
  }
}

function dot(context, [x, y]) {
  const radius = DOT_PX * devicePixelRatio;
  context.moveTo(x + radius, y);
  context.arc(x, y, radius, 0, 2 * Math.PI);
}

// Shaft and head as one outline; an arrow that is shorter than its head has no shaft.
function outline(context, from, to) {
  const { corners: [left, tip, right], base } = headOf(from, to);
  const along = [base[0] - from[0], base[1] - from[1]], length = Math.hypot(...along);
  if (along[0] * (to[0] - from[0]) + along[1] * (to[1] - from[1]) <= 0) return polygon(context, [left, tip, right]);
  const half = 0.5 * SHAFT_PX * devicePixelRatio / length, x = -half * along[1], y = half * along[0];
  polygon(context, [
    [from[0] + x, from[1] + y], [base[0] + x, base[1] + y], right, tip, left, [base[0] - x, base[1] - y], [from[0] - x, from[1] - y],
  ]);
}

function headOf([x0, y0], [x1, y1]) {
  const ratio = devicePixelRatio, angle = Math.atan2(y1 - y0, x1 - x0);
  const size = Math.min(LONGEST_HEAD_PX * ratio, HEAD_SHARE * Math.hypot(x1 - x0, y1 - y0) + SMALLEST_HEAD_PX * ratio);
  const behind = (turn) => [x1 - size * Math.cos(angle + turn), y1 - size * Math.sin(angle + turn)];
  const left = behind(HEAD_TURN), right = behind(-HEAD_TURN);
  return { corners: [left, [x1, y1], right], base: [(left[0] + right[0]) / 2, (left[1] + right[1]) / 2] };
}

function polygon(context, corners) {
  corners.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
  context.closePath();
}

function dashed(context, from, to) {
  context.setLineDash(DASH_PX.map((length) => length * devicePixelRatio));
  context.beginPath();
  context.moveTo(...from);
  context.lineTo(...to);
  context.stroke();
  context.setLineDash([]);
}

function cross(context, [x, y]) {
  const size = CROSS_PX * devicePixelRatio;
  context.beginPath();
  for (const way of [1, -1]) {
    context.moveTo(x - size, y - way * size);
    context.lineTo(x + size, y + way * size);
  }
  context.stroke();
}
