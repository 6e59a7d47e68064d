// One line that says how the stream is: the worst of what is known, in plain words.
const SAID = {
  OK: ["good", "running", "Everything that came was tracked in time."],
  "CATCHING UP": ["poor", "catching up", "A stretch is tracked again after a jump in time or with other settings."],
  OVERLOAD: ["poor", "slower than real time", "This machine cannot track as fast as asked; time passes more slowly, no event is left out."],
  STALE: ["bad", "no pictures", "The session sends nothing; it may be waiting for the camera."],
  DISCONNECTED: ["bad", "source lost", "The source has ended with a fault; what came before can still be looked at."],
  CLOSED: ["bad", "connection lost", "The command that serves this page has ended, or cannot be reached."],
  CONNECTING: ["", "connecting", "Waiting for the command that serves this page."],
  STARTING: ["", "starting", "The first start on a machine compiles for some seconds."],
};
const LATE_SHARE = [0.25, 0.5], MEMORY = 0.03; // of the last half second's pictures: not late, late
let lateShare = 0, late = false;

// A machine at its limit is late now and then; the line does not flicker with it.
export function steady(state) {
  if (state !== "OK" && state !== "OVERLOAD") return state;
  lateShare += MEMORY * ((state === "OVERLOAD") - lateShare);
  late = lateShare > LATE_SHARE[late ? 0 : 1];
  return late ? "OVERLOAD" : "OK";
}

export function showHealth(tag, state, failure) {
  let [level, said, about] = SAID[state] ?? ["", state.toLowerCase(), ""];
  if (failure) about = `${about} ${failure}`;
  const shown = [level, said, about, state].join();
  if (tag.dataset.shown === shown) return;
  tag.dataset.shown = shown;
  if (tag.textContent !== said) tag.textContent = said;
  tag.dataset.level = level;
  tag.dataset.state = state;
  tag.title = about;
}
