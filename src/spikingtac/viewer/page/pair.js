// Two ordinary pages side by side; each names its finger, and passes on the token of this one.
const frames = ["first", "second"].map((id) => document.getElementById(id));
const spans = () => frames.map((frame) => frame.contentWindow.__m?.hello).map((hello) => hello?.ends && hello.overview);

// Recordings are on one clock: both go to the nearest time that both hold. Live, a time is one finger's own.
window.together = (command, finger) => {
  const overviews = spans(), recorded = overviews.every(Boolean);
  if ("seek_us" in command && recorded) {
    const first = Math.max(...overviews.map((span) => span.t_start_us)), last = Math.min(...overviews.map((span) => span.t_end_us));
    command = { seek_us: Math.max(Math.min(command.seek_us, last), first) };
  }
  const one = "seek_us" in command && !recorded;
  for (const view of one ? [finger] : frames.map((frame) => frame.contentWindow)) view.__m.send(command);
};

for (const [number, frame] of frames.entries()) {
  const query = new URLSearchParams(location.search);
  query.set("finger", number);
  frame.src = `index.html?${query}`;
}

const begin = setInterval(() => {
  const views = frames.map((frame) => frame.contentWindow.__m);
  if (!views.every((view) => view?.hello && view.connected)) return;
  clearInterval(begin);
  if (spans().every(Boolean)) window.together({ seek_us: 0 });
}, 100);
