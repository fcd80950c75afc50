"use strict";
// The controls send what has changed; the answer is shown.

const at = id => document.getElementById(id);
let about, marked = "", isBusy = false, isWaiting = false, answers = 0;
const changes = {};
const controls = {};

const numbersOf = value => typeof value === "number" ? [value] : value && value.uniform ? value.uniform : null;
const written = value => value === null ? "not set" : JSON.stringify(value).replaceAll('"', "");
const isEqual = (value, other) => JSON.stringify(value) === JSON.stringify(other);

function valueOf(parameter) {
  return parameter.key in changes ? changes[parameter.key] : parameter.value;
}

function change(parameter, value) {
  if (isEqual(value, parameter.value)) delete changes[parameter.key];
  else changes[parameter.key] = value;
  controls[parameter.key].show();
  update();
}

function element(tag, properties, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

// One slider and one field for a number, two of each for a range.
function numberInputs(parameter, show) {
  const value = valueOf(parameter), numbers = numbersOf(value) || [controls[parameter.key].drawn ?? parameter.low];
  const pairs = numbers.map((number, index) => {
    const side = numbers.length > 1 ? [" from", " to"][index] : "";
    const limits = { min: parameter.low, max: parameter.high, step: parameter.step };
    const slider = element("input", { type: "range", ...limits, value: number, ariaLabel: parameter.key + side });
    const field = element("input", { type: "number", step: "any", ariaLabel: `${parameter.key}${side}, value` });
    field.value = numbersOf(value) ? number : "";
    field.placeholder = value === null ? "not set" : "drawn";
    for (const input of [slider, field]) {
      input.addEventListener("input", () => {
        if (input.value === "" && !parameter.can_be_null) return;
        const entered = input.value === "" ? null : +input.value;
        (input === slider ? field : slider).value = input.value;
        change(parameter, withNumber(valueOf(parameter), index, entered));
      });
    }
    return [slider, field];
  });
  show(pairs.flat());
}

function withNumber(value, index, number) {
  if (!value || !value.uniform || number === null) return number;
  const ends = [...value.uniform];
  ends[index] = number;
  return { uniform: index ? [Math.min(...ends), number] : [number, Math.max(...ends)] };
}

function isRange(parameter) {
  return Boolean(valueOf(parameter) && valueOf(parameter).uniform);
}

function toggleRange(parameter) {
  const numbers = numbersOf(valueOf(parameter)) || [controls[parameter.key].drawn ?? parameter.low];
  const middle = numbers.reduce((sum, number) => sum + number) / numbers.length;
  if (isRange(parameter)) { change(parameter, +middle.toPrecision(6)); return; }
  const reach = (parameter.high - parameter.low) / 10;
  const ends = [Math.max(middle - reach, parameter.low), Math.min(middle + reach, parameter.high)];
  change(parameter, { uniform: ends.map(end => +end.toPrecision(6)) });
}

// The sentence, the ends of the slider, and what was drawn; or why it does nothing.
function noteOf(parameter) {
  const { drawn, reason } = controls[parameter.key], value = valueOf(parameter);
  if (reason) return `${parameter.key}: ${reason}`;
  const sentence = parameter.sentence.replace(/\.$/, "");
  if (parameter.kind !== "number") return `${sentence}.`;
  const isOther = value !== null && !numbersOf(value);
  const form = isOther ? ` Of ${written(value)}.` : "";
  const here = drawn !== undefined && typeof value === "object" ? ` Drawn here: ${+drawn.toPrecision(4)}.` : "";
  return `${sentence}. ${parameter.low} to ${parameter.high} ${parameter.unit}`.trim() + `.${form}${here}`;
}

function build(parameter) {
  const name = parameter.key.slice(parameter.group.length + 1), id = `control-${parameter.key}`;
  const label = element("label", { htmlFor: id, textContent: name });
  const note = element("p", {});
  const reset = element("button", { type: "button", textContent: "reset", ariaLabel: `reset ${parameter.key}` });
  reset.addEventListener("click", () => change(parameter, parameter.value));
  const tools = [reset];
  if (parameter.can_be_drawn) {
    const range = element("button", { type: "button", textContent: "range", ariaLabel: `${parameter.key}: number or range` });
    range.addEventListener("click", () => toggleRange(parameter));
    tools.unshift(range);
  }
  if (parameter.kind !== "switch") {
    const mark = element("input", { type: "radio", name: "sweep", title: "sweep it", ariaLabel: `sweep ${parameter.key}` });
    mark.addEventListener("change", () => markForSweep(parameter));
    tools.unshift(mark);
  }
  const row = element("div", { className: "parameter" }, label, ...tools, note);
  row.dataset.key = parameter.key;
  const control = { row, drawn: undefined, reason: "", form: undefined };
  let inputs = [];
  const place = made => {
    inputs.forEach(input => input.remove());
    inputs = made;
    inputs[0].id = id;
    note.before(...inputs);
  };
  control.show = () => {
    const value = valueOf(parameter), numbers = numbersOf(value), form = numbers ? numbers.length : 0;
    if (parameter.kind === "number" && form !== control.form) numberInputs(parameter, place);
    else if (parameter.kind === "switch") inputs[0].checked = value;
    else if (parameter.kind === "choice") inputs[0].value = value;
    else if (numbers) numbers.forEach((number, index) => {
      for (const input of inputs.slice(2 * index, 2 * index + 2)) if (input !== document.activeElement) input.value = number;
    });
    control.form = form;
    row.classList.toggle("changed", parameter.key in changes);
    row.classList.toggle("inert", Boolean(control.reason));
    note.textContent = noteOf(parameter);
  };
  controls[parameter.key] = control;
  if (parameter.kind === "switch") {
    const box = element("input", { type: "checkbox" });
    box.addEventListener("change", () => change(parameter, box.checked));
    place([box]);
  } else if (parameter.kind === "choice") {
    const choice = element("select", {}, ...parameter.words.map(word => new Option(word, word)));
    choice.addEventListener("change", () => change(parameter, choice.value));
    place([choice]);
  }
  control.show();
  return row;
}

function markForSweep(parameter) {
  marked = parameter.key;
  const { low, high, words } = parameter, middle = (low + high) / 2;
  at("sweep-key").textContent = parameter.key;
  at("sweep-values").disabled = false;
  at("sweep-values").value = words.length ? words.join(",") : [low, middle, high].map(number => +number.toPrecision(4)).join(",");
  update();
}

function request() {
  const seed = +at("seed").value;
  return {
    changes: { ...changes, ...(seed === about.seed ? {} : { seed }) },
    frame: +at("frame").value, right: at("right-kind").value, real: +at("real").value,
    ...(marked ? { sweep: [marked, at("sweep-values").value] } : {}),
  };
}

async function ask(path) {
  const answer = await fetch(`${path}?${encodeURIComponent(JSON.stringify(request()))}`);
  if (!answer.ok) throw new Error(await answer.text());
  return answer.json();
}

// While one answer is on its way, only the latest wish waits.
async function update() {
  if (isBusy) { isWaiting = true; return; }
  isBusy = true;
  const begun = performance.now();
  try {
    show(await ask("images.json"));
    at("error").textContent = "";
    at("time").textContent = `${Math.round(performance.now() - begun)} ms`;
  } catch (error) {
    at("error").textContent = error.message;
  }
  document.body.dataset.answers = ++answers;
  isBusy = false;
  if (isWaiting) { isWaiting = false; update(); }
}

function show(answer) {
  showImage(at("left"), answer.left);
  showImage(at("right"), answer.right);
  for (const side of ["left", "right"]) at(side).classList.toggle("polar", answer.is_polar);
  const simulated = answer.left.charts, beside = answer.right.charts;
  showCurves(at("histogram"), simulated.histogram, beside.histogram, "white");
  showCurves(at("spectrum"), simulated.spectrum_db, beside.spectrum_db, "0.5 cycles/pixel");
  showCurves(at("rows"), simulated.grain_rows, beside.grain_rows, "23 pixels");
  showCurves(at("columns"), simulated.grain_columns, beside.grain_columns, "23 pixels");
  for (const [name, text] of Object.entries(answer.exports)) at(name).value = text;
  for (const [key, control] of Object.entries(controls)) {
    control.drawn = answer.drawn[key];
    control.reason = answer.inert[key] || "";
    control.show();
  }
}

async function drawSix() {
  try {
    const { images } = await ask("draws.json");
    at("draws").hidden = false;
    at("draws").replaceChildren(...images.map((image, index) => {
      const canvas = element("canvas", { role: "img", ariaLabel: `draw ${index + 1}` });
      showImage(canvas, image);
      return canvas;
    }));
  } catch (error) {
    at("error").textContent = error.message;
  }
}

function resetAll() {
  for (const key of Object.keys(changes)) delete changes[key];
  at("seed").value = about.seed;
  Object.values(controls).forEach(control => control.show());
  update();
}

function buildControls() {
  const groups = {};
  for (const parameter of about.parameters) (groups[parameter.group] ||= []).push(parameter);
  const acts = parameters => parameters.some(({ key, value }) => /^noise\..*\.enabled$/.test(key) && value);
  const sections = Object.entries(groups).map(([group, parameters]) => {
    const details = element("details", {}, element("summary", { textContent: group }), ...parameters.map(build));
    details.open = acts(parameters);
    return details;
  });
  // The effects that act come first.
  at("controls").append(...sections.filter(section => section.open), ...sections.filter(section => !section.open));
}

(async () => {
  about = await (await fetch("about.json")).json();
  at("words").textContent = about.words;
  at("frame").max = about.frames.length - 1;
  at("frame").value = about.frame;
  at("seed").value = about.seed;
  at("real").max = about.real_frames - 1;
  at("real-label").hidden = about.real_frames < 2;
  if (about.real === null) at("right-kind").options[0].remove();
  else at("right-kind").options[0].textContent = about.real;
  buildControls();
  for (const id of ["frame", "seed", "right-kind", "real", "sweep-values"]) at(id).addEventListener("input", update);
  at("draw").addEventListener("click", drawSix);
  at("reset").addEventListener("click", resetAll);
  at("controls").addEventListener("submit", event => event.preventDefault());
  await update();
})();
