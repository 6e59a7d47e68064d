// The tuning panel, made from what the configuration's fields say of themselves.
import { WORDS } from "./words.js";

export function buildControls(holder, controls, set) {
  holder.replaceChildren(...controls.map((control) => build(control, set)));
}

export function refreshControls(holder, controls) {
  for (const control of controls) {
    const input = holder.querySelector(`[data-name="${CSS.escape(control.name)}"]`);
    if (!input || input === document.activeElement) continue;
    if (control.kind === "switch") input.checked = control.value;
    else input.value = control.value;
    const output = input.closest(".control").querySelector("output");
    if (output) output.value = text(control, control.value);
  }
}

function build(control, set) {
  const row = document.createElement("div"), id = `control-${control.name}`;
  row.className = "control";
  const label = document.createElement("label");
  label.htmlFor = id;
  const plain = control.name.split(".").at(-1).replace(/_(us|ms|px|mm|hz)$/, "").replaceAll("_", " ");
  const [name, explained] = WORDS[control.name] ?? [plain, ""];
  label.textContent = name;
  row.title = `${explained} (${control.name})`.trim();
  const input = control.kind === "choice" ? choice(control) : field(control);
  Object.assign(input, { id });
  input.dataset.name = control.name;
  input.dataset.testid = `control-${control.name}`;
  const output = document.createElement("output");
  output.className = "number";
  output.value = text(control, control.value);
  input.addEventListener("input", () => {
    const value = read(control, input);
    output.value = text(control, value);
    set(control.name, value);
  });
  row.append(label, ...(control.kind === "choice" || control.kind === "switch" ? [input] : [output, input]));
  return row;
}

function field(control) {
  const input = document.createElement("input");
  if (control.kind === "switch") {
    input.type = "checkbox";
    input.checked = control.value;
    return input;
  }
  Object.assign(input, { type: "range", min: control.low, max: control.high, step: control.step });
  input.value = control.value;
  return input;
}

function choice(control) {
  const select = document.createElement("select");
  for (const name of control.choices) select.append(new Option(name, name));
  select.value = control.value;
  return select;
}

function read(control, input) {
  if (control.kind === "switch") return input.checked;
  return control.kind === "choice" ? input.value : Number(input.value);
}

function text(control, value) {
  return typeof value === "number" ? `${+value.toPrecision(4)} ${control.unit}`.trim() : "";
}
