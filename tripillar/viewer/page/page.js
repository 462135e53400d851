// The page in the browser: its controls go to the server, what the server says is shown. It keeps nothing of its own but
// what was said last, from which a lost connection goes on.

import { loadState, save, savePicture } from "./files.js";
import { watchPicture } from "./picture.js";
import { Plot } from "./plot.js";

const all = (selector, within = document) => [...within.querySelectorAll(selector)];
const byId = id => document.getElementById(id);
const RETRY_MS = 2000, FULL = 1013;

let facts = null;  // of the array and its controls; null before the server has said them
let socket = null;
const controls = {}, said = {};  // values of controls; what else the server says

function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

const state = () => ({ controls, traction_mpa: said.traction_mpa });  // all that a browser has set

function set(name, value) {
  controls[name] = value;
  showControls();
  send({ set: { [name]: value } });
}

function connect() {
  socket = new WebSocket(new URL("socket", location.href.replace(/^http/, "ws")));
  socket.binaryType = "blob";
  socket.onmessage = ({ data }) => (typeof data === "string" ? hear(JSON.parse(data)) : picture.show(data));
  socket.onclose = ({ code, reason }) => {
    byId("trouble").textContent = code === FULL ? reason : "no connection: has tripillar ended?";
    if (code !== FULL) setTimeout(connect, RETRY_MS);
  };
}

function hear(message) {
  if (message.facts) {
    if (!facts) lay(message.facts);
    else if (said.traction_mpa) send({ restore: state() });
    byId("trouble").textContent = "";
    picture.resize();
  }
  if (message.file) save(message.file.name, message.file.text);
  if (message.refused) byId("trouble").textContent = message.refused;
  if (message.show) {
    Object.assign(controls, message.show.controls);
    const isFirst = !said.traction_mpa;
    Object.assign(said, message.show);
    showControls();
    if (isFirst && matchMedia("(prefers-color-scheme: dark)").matches) set("dark", true);
    for (const [name, value] of Object.entries(message.show)) showers[name]?.(value);
  }
}

// once: what depends on the array

function lay(given) {
  facts = given;
  byId("array").textContent = `${facts.rows} × ${facts.cols} units, pitch ${facts.pitch_mm} mm${facts.pads === "stiff" ? ", stiff pads" : ""}`;
  byId("cap").textContent = facts.cap;
  byId("cone").textContent = `shear ≤ ${facts.friction} × pressure`;
  byId("decoupler").textContent = `decoupled forces, by ${facts.decoupler}`;
  byId("by-sensor").hidden = facts.sensor === null;
  byId("port").textContent = facts.sensor ?? "";
  document.body.style.setProperty("--cols", facts.cols);
  for (const control of all("[data-control]")) {
    const name = control.dataset.control, kind = facts.kinds[name];
    if (control.type === "range") {
      Object.assign(control, { min: kind.min, max: kind.max, step: kind.step });
      control.oninput = () => set(name, control.valueAsNumber);
    } else if (control.type === "checkbox") {
      control.onchange = () => set(name, control.checked);
    } else if (control.localName === "select") {
      control.replaceChildren(...kind.titles.map((title, place) => new Option(title, place)));
      control.onchange = () => set(name, kind.among[control.value]);
    } else {
      control.onclick = () => set(name, control.value);
    }
  }
  for (const button of all("[data-do]")) button.onclick = () => send({ do: button.dataset.do });
  for (const button of all("[data-file]")) button.onclick = () => send({ file: button.dataset.file });
  byId("save-picture").onclick = () => savePicture(byId("picture"), said, document.documentElement);
  byId("save-state").onclick = () => save("tripillar-state.json", JSON.stringify(state()));
  byId("open-state").onclick = () => byId("load-state").click();
  byId("load-state").onchange = event => loadState(event.target, state => send({ restore: state }));
  byId("save-plot").onclick = () => save("tripillar-time.csv", plot.csv());
  plot.lay(facts, byId("plotted"), byId("plotted-pads"), byId("clear-plot"));
  for (const place of [byId("pads"), byId("plotted-pads")]) number(place);
}

function showControls() {
  for (const control of all("[data-control]")) {
    const name = control.dataset.control, value = controls[name];
    if (control.type === "range") {
      const { max } = facts.kinds[name], above = control.dataset.below;
      const limit = above && controls.cone ? Math.min(max, facts.friction * controls[above]) : max;
      control.max = limit;
      control.value = value;
      const output = control.parentElement.querySelector("output");
      output.textContent = `${+Math.min(value, limit).toFixed(2)} ${output.dataset.unit}`;
    } else if (control.type === "checkbox") control.checked = value;
    else if (control.localName === "select") control.value = facts.kinds[name].among.indexOf(value);
    else control.classList.toggle("on", control.value === value);
  }
  for (const part of all("[data-when]")) {
    const [name, values] = part.dataset.when.split("=");
    part.hidden = !values.split("|").includes(controls[name]);
  }
  const kind = controls.source === "sensor" ? "decoupled pressure" : "pressure";
  byId("pads-caption").textContent = `${kind} on pads [MPa]`;
  document.documentElement.classList.toggle("dark", controls.dark);
  plot.show(controls.tab === "time", controls.pad);
  for (const cell of all("[data-unit-number]")) cell.classList.toggle("chosen", +cell.dataset.unitNumber === controls.pad);
}

// what the server says, by its name

const showers = {
  pads: cells => fill(byId("pads"), cells, "button", (button, cell) => {
    button.id = `pad-${cell.unit}`;
    asCell(button, cell);
    text(part(button, 0, "span"), cell.text);
    text(part(button, 1, "small"), cell.arrow);
  }),
  resistance_maps: maps => showMaps(byId("resistance-maps"), maps),
  force_maps: maps => showMaps(byId("force-maps"), maps),
  unit_pillars: rows => showRows(byId("unit-pillars"), rows),
  unit_forces: rows => showRows(byId("unit-forces"), rows),
  rows: rows => showRows(byId("whole-table"), rows),
  rms: rms => text(byId("rms"), rms && `all forces missed by ${rms} N (rms)`),
  trouble: trouble => text(byId("trouble"), trouble),
  contacts: contacts => fill(byId("contacts"), contacts, "li", text),
  faults: faults => fill(byId("faults"), faults, "li", text),
  ended: ended => (byId("play-again").hidden = !ended),
  strain_share: share => (document.querySelector(".gauge div").style.width = `${share}%`),
  strain_over: over => document.querySelector(".gauge div").classList.toggle("over", over),
  sample: values => plot.add(values),
  legend: bars => fill(byId("legend"), bars, "div", (element, { title, colours, labels }) => {
    element.className = "key";
    text(part(element, 0, "span"), title);
    part(element, 1, "div").style.background = `linear-gradient(to right, ${colours.join()})`;
    fill(part(element, 2, "p"), labels, "span", (label, [place, words]) => {
      text(label, words);
      label.style.left = `${100 * place}%`;
    });
  }),
};
for (const element of all("[data-text]")) {
  const name = element.dataset.text, before = showers[name];
  showers[name] = value => (before?.(value), text(element, value));
}

function showMaps(place, maps) {
  fill(place, maps, "div", (element, map) => {
    element.className = "map";
    const caption = part(element, 0, "div"), cells = element.querySelector(".cells") ?? part(element, 1, "div");
    caption.className = "caption";
    if (!cells.className) {
      cells.className = "cells";
      number(cells);
    }
    text(part(caption, 0, "b"), map.title);
    text(part(caption, 1, "span"), `± ${map.most} ${map.unit}`);
    fill(cells, map.cells, "div", (box, cell) => {
      asCell(box, cell);
      text(part(box, 0, "span"), cell.text);
      box.title = `${cell.text} ${map.unit}`;
    });
  });
}

// numbers of rows at the left of cells, from the last down as the array lies, and of columns below

function number(cells) {
  const around = document.createElement("div"), rows = document.createElement("ol"), cols = document.createElement("ol");
  around.className = "numbered";
  cells.replaceWith(around);
  around.append(rows, cells, cols);
  const numbers = n => [...Array(n).keys()];
  fill(rows, numbers(facts.rows).reverse(), "li", (item, row) => text(item, `${row}`));
  fill(cols, numbers(facts.cols), "li", (item, col) => text(item, `${col}`));
}

function asCell(element, { unit, colour }) {
  element.style.background = colour;
  if (element.dataset.unitNumber === undefined) element.onclick = () => set("pad", +element.dataset.unitNumber);
  element.dataset.unitNumber = unit;
  element.classList.toggle("chosen", unit === controls.pad);
}

function showRows(table, rows) {
  fill(table.tBodies[0], rows, "tr", (tr, row) => fill(tr, row, "td", text));
}

// as many children as items, each shown in its own

function fill(place, items, tag, show) {
  while (place.children.length > items.length) place.lastChild.remove();
  items.forEach((item, number) => show(part(place, number, tag), item));
}

function part(place, number, tag) {
  return place.children[number] ?? place.appendChild(document.createElement(tag));
}

function text(element, value) {
  if (element.textContent !== value) element.textContent = value;
}

const plot = new Plot(byId("plot"));
const picture = watchPicture(document.querySelector(".view"), byId("picture"), send);
history.replaceState(null, "", location.pathname);  // the token is in the cookie now
connect();
