// Forces and readings of some pads over the last minute. Every unit is remembered, so a pad that is added shows its past.

import { AXES, ofUnit, pillarTitles } from "./numbers.js";

const SECONDS = 60, COLOURS = 6, MOST = 60 * 200;

export class Plot {
  constructor(canvas) {
    this.canvas = canvas;
    this.samples = [];  // {t, values: of each unit those of `names`}
    this.pads = new Set();
    this.quantity = 2;
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  lay(facts, select, cells, clear) {
    this.facts = facts;
    this.names = [...AXES.map(axis => `F${axis} [N]`), ...pillarTitles(facts).map(title => `${title}, change [%]`)];
    select.replaceChildren(...this.names.map((name, place) => new Option(name, place)));
    select.value = this.quantity;
    select.onchange = () => (this.quantity = +select.value, this.draw());
    clear.onclick = () => (this.samples = [], this.draw());
    for (let row = facts.rows - 1; row >= 0; row--) {
      for (let col = 0; col < facts.cols; col++) {
        const unit = row * facts.cols + col, button = document.createElement("button");
        button.title = `row ${row}, col ${col}`;
        button.dataset.plotted = unit;
        button.onclick = () => {
          this.isPicked = true;
          if (!this.pads.delete(unit)) this.pads.add(unit);
          this.draw();
        };
        cells.append(button);
      }
    }
    this.cells = cells;
  }

  show(isShown, chosen) {
    if (!this.isPicked) this.pads = new Set([chosen]);  // until someone says which
    clearInterval(this.timer);
    if (isShown) this.timer = setInterval(() => this.draw(), 200);
  }

  add({ force_n, change_pct }) {
    const t = performance.now() / 1000, n = this.facts.pillars.length;
    const values = Array.from({ length: force_n.length / AXES.length },
      (_, unit) => [...ofUnit(force_n, unit, AXES.length), ...ofUnit(change_pct, unit, n)]);
    this.samples.push({ t, values });
    while (this.samples.length > MOST || this.samples[1]?.t < t - SECONDS) this.samples.shift();
    this.draw();
  }

  colour(unit) {
    const place = [...this.pads].indexOf(unit);
    return getComputedStyle(document.documentElement).getPropertyValue(`--plot-${place % COLOURS}`);
  }

  name = unit => `row ${Math.floor(unit / this.facts.cols)}, col ${unit % this.facts.cols}`;

  csv() {
    const changes = this.facts.pillars.map(pillar => `${pillar}_change_pct`);
    const pads = [...this.pads], names = [...AXES.map(axis => `f${axis}_n`), ...changes];
    const head = ["time_s", ...pads.flatMap(unit => names.map(name => `${name} of ${this.name(unit).replace(",", "")}`))];
    const start = this.samples[0]?.t ?? 0;
    const lines = this.samples.map(({ t, values }) => [(t - start).toFixed(4), ...pads.flatMap(unit => values[unit])]);
    return [head, ...lines].map(line => line.join()).join("\n") + "\n";
  }

  draw() {
    const { canvas, samples, quantity } = this, wide = canvas.clientWidth, high = canvas.clientHeight;
    if (!wide || !this.cells) return;
    for (const cell of this.cells.children) {
      const unit = +cell.dataset.plotted, isIn = this.pads.has(unit);
      cell.style.background = isIn ? this.colour(unit) : "";
    }
    const ratio = devicePixelRatio, context = canvas.getContext("2d"), style = getComputedStyle(canvas);
    canvas.width = wide * ratio;
    canvas.height = high * ratio;
    context.scale(ratio, ratio);
    context.font = `11px ${style.fontFamily}`;
    context.fillStyle = context.strokeStyle = style.getPropertyValue("--dim");
    const now = performance.now() / 1000, pads = [...this.pads];
    const seen = samples.flatMap(({ values }) => pads.map(unit => values[unit][quantity])).filter(value => value !== null);
    let low = Math.min(0, ...seen), high_ = Math.max(0, ...seen);
    if (high_ - low < 1e-9) high_ = low + 1;
    const step = round((high_ - low) / 4), left = 44, bottom = high - 30, top = 20;
    low = step * Math.floor(low / step + 0.05);  // noise about 0 needs no room
    high_ = step * Math.ceil(high_ / step - 0.05);
    const x = t => left + (wide - left - 8) * (1 - (now - t) / SECONDS);
    const y = value => bottom - (bottom - top) * (value - low) / (high_ - low);
    context.lineWidth = 1;
    context.textAlign = "right";
    for (let value = low; value <= high_ + step / 2; value += step) {
      context.globalAlpha = Math.abs(value) < step / 2 ? 0.8 : 0.25;
      line(context, [[left, y(value)], [wide - 8, y(value)]]);
      context.globalAlpha = 1;
      context.fillText(`${+value.toPrecision(6)}`.replace("-", "−"), left - 6, y(value) + 4);
    }
    context.textAlign = "center";
    for (let ago = SECONDS; ago >= 0; ago -= 15) context.fillText(ago ? `−${ago}` : "now", Math.min(x(now - ago), wide - 18), bottom + 14);
    context.fillText("time [s]", (left + wide) / 2, bottom + 27);
    context.textAlign = "left";
    context.fillText(this.names[quantity], 0, 11);
    context.lineWidth = 2;
    context.save();
    context.beginPath();
    context.rect(left, 0, wide - left, high);
    context.clip();
    for (const unit of pads) {
      context.strokeStyle = this.colour(unit);
      const points = samples.map(({ t, values }) => [x(t), values[unit][quantity]]).filter(([, value]) => value !== null);
      const path = points.flatMap(([at, value], k) => [...(k ? [[at, y(points[k - 1][1])]] : []), [at, y(value)]]);
      if (path.length) line(context, [...path, [x(now), path.at(-1)[1]]]);  // what was said last still holds
    }
    context.restore();
  }
}

function line(context, points) {
  context.beginPath();
  for (const [x, y] of points) context.lineTo(x, y);
  context.stroke();
}

function round(most) {
  const tens = 10 ** Math.floor(Math.log10(most));
  return tens * [1, 2, 2.5, 5, 10].find(step => step * tens >= most - 1e-12);
}
