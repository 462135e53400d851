// The page in the browser: its controls go to the server, what the server says is shown. It keeps nothing of its own but
// what was said last, from which a lost connection goes on.

import { loadState, save, savePicture } from "./files.js";
import {
  colour, csv, forcesHead, largestStrain, missed, tableHead, tableRows, unitForces, unitPillars, words, ARROWS, MAPS,
} from "./numbers.js";
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
  if (message.refused) byId("trouble").textContent = message.refused;
  if (message.show) {
    Object.assign(controls, message.show.controls);
    const isFirst = !said.traction_mpa;
    Object.assign(said, message.show);
    if (message.show.force_n || message.show.change_pct) plot.add(said);
    if (message.show.trouble !== undefined) byId("trouble").textContent = message.show.trouble;
    showControls();
    if (isFirst && matchMedia("(prefers-color-scheme: dark)").matches) set("dark", true);
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
  document.body.style.setProperty("--across", facts.pillars.length % 3 ? 4 : 3);
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
  byId("save-csv").onclick = () => save("tripillar.csv", csv(facts, said));
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
      output.textContent = `${+Math.min(value, limit).toPrecision(3)} ${output.dataset.unit}`;
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
  if (said.force_n) showNumbers();
  showTexts();
}

// what the server says

function showTexts() {
  for (const element of all("[data-text]")) text(element, said[element.dataset.text] ?? "");
  for (const name of ["contacts", "faults"]) fill(byId(name), said[name] ?? [], "li", text);
  byId("play-again").hidden = !said.ended;
  document.documentElement.classList.toggle("stale", said.is_stale ?? false);
  fill(byId("legend"), said.legend ?? [], "div", (element, { title, colours, labels }) => {
    element.className = "key";
    text(part(element, 0, "span"), title);
    part(element, 1, "div").style.background = `linear-gradient(to right, ${colours.join()})`;
    fill(part(element, 2, "p"), labels, "span", (label, [place, words]) => {
      text(label, words);
      label.style.left = `${100 * place}%`;
    });
  });
}

function showNumbers() {
  const { pad } = controls, isFollowed = controls.source === "sensor", most = facts.kinds.pressure.max;
  const digits = Math.max(1, Math.ceil(1 - Math.log10(most)));
  const [strain, place] = largestStrain(facts, said), gauge = document.querySelector(".gauge div");
  Object.assign(said, { unit_name: nameOf(pad), strain: words(strain, 1), strain_at: place, rms: missed(said) });
  gauge.style.width = `${Math.min(100 * strain / facts.cap, 100)}%`;
  gauge.classList.toggle("over", strain > facts.cap);
  fill(byId("pads"), lying(), "button", (button, unit) => {
    const [x, y, z] = said.traction_mpa.slice(3 * unit), eighth = Math.round(4 * Math.atan2(y, x) / Math.PI);
    button.id = `pad-${unit}`;
    asCell(button, unit, colour(-z, most));
    text(part(button, 0, "span"), Math.abs(z) > 0.004 * most ? words(-z, Math.abs(z) < 10 ? digits : 0) : "");
    text(part(button, 1, "small"), Math.hypot(x, y) > 0.004 * most ? ARROWS[(eighth + 8) % 8] : "");
  });
  showRows(byId("unit-pillars"), unitPillars(facts, said, pad));
  showRows(byId("unit-forces"), unitForces(said, pad, isFollowed), forcesHead(isFollowed));
  if (controls.tab === "maps") for (const [id, map] of Object.entries(MAPS)) showMaps(byId(id), map);
  if (controls.tab === "table") showRows(byId("whole-table"), tableRows(facts, said, isFollowed), tableHead(facts, isFollowed));
}

// the strongest colour is of the largest value, but at least of `least`, so that noise at rest stays pale

function showMaps(place, { titles, name, unit, ...map }) {
  const titled = titles(facts), digits = map.digits(facts), least = map.least(facts);
  fill(place, titled, "div", (element, title, which) => {
    const values = said[name].filter((_, at) => at % titled.length === which), most = Math.max(least, ...values.map(Math.abs));
    element.className = "map";
    const caption = part(element, 0, "div"), cells = element.querySelector(".cells") ?? part(element, 1, "div");
    caption.className = "caption";
    if (!cells.className) {
      cells.className = "cells";
      number(cells);
    }
    text(part(caption, 0, "b"), title);
    text(part(caption, 1, "span"), `± ${words(most, digits)} ${unit}`);
    fill(cells, lying(), "div", (box, place) => {
      asCell(box, place, colour(values[place], most));
      text(part(box, 0, "span"), words(values[place], digits));
      box.title = `${words(values[place], digits)} ${unit}`;
    });
  });
}

const nameOf = unit => `row ${Math.floor(unit / facts.cols)}, col ${unit % facts.cols}`;

// units as the array lies before you: y up

function lying() {
  const { rows, cols } = facts;
  return Array.from({ length: rows * cols }, (_, place) => cols * (rows - 1 - Math.floor(place / cols)) + place % cols);
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

function asCell(element, unit, shade) {
  element.style.background = shade;
  if (element.dataset.unitNumber === undefined) element.onclick = () => set("pad", +element.dataset.unitNumber);
  element.dataset.unitNumber = unit;
  element.classList.toggle("chosen", unit === controls.pad);
}

function showRows(table, rows, head) {
  if (head) fill(table.tHead.rows[0], head, "th", text);
  fill(table.tBodies[0], rows, "tr", (tr, row) => fill(tr, row, "td", text));
}

// as many children as items, each shown in its own

function fill(place, items, tag, show) {
  while (place.children.length > items.length) place.lastChild.remove();
  items.forEach((item, number) => show(part(place, number, tag), item, number));
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
