// Numbers beside the picture, as text, colours and rows, and as CSV; null is unknown. What the server says of all units is
// one list with a number for each axis of each unit, or for each of its pillars, which the facts name.

export const AXES = ["x", "y", "z"];
export const ARROWS = "→↗↑↖←↙↓↘";  // of shear, by eighths of a turn from +x
export const MAPS = {
  "resistance-maps": { titles: ({ pillars }) => pillars, name: "change_pct", unit: "%", digits: () => 1, least: () => 2 },
  "force-maps": {
    titles: () => AXES.map(name => `F${name}`), name: "force_n", unit: "N",
    digits: ({ least_n }) => (least_n < 1 ? 2 : 0), least: ({ least_n }) => least_n,
  },
};

export function pillarTitles({ pillars }) {
  return pillars.map(name => `${name} pillar`);
}

export function words(value, digits) {
  if (value === null) return "–";
  if (value === Infinity) return "∞";
  const rounded = value.toFixed(digits);
  return rounded.replace("-", +rounded ? "−" : "");
}

// red above 0, blue below, more opaque the larger, so that it suits a pale and a dark page

export function colour(value, most) {
  if (value === null) return "transparent";
  return `rgba(${value > 0 ? "214,69,65" : "47,110,186"},${Math.min(Math.abs(value / most), 1).toFixed(3)})`;
}

const minus = (one, other) => (one === null || other === null ? null : one - other);
export const ofUnit = (values, unit, n) => values.slice(n * unit, n * unit + n);
const three = (values, unit) => ofUnit(values, unit, 3);

export function unitPillars({ pillars }, { resistance_ohm, change_pct, strain_pct }, unit) {
  const [ohm, change, strain] = [resistance_ohm, change_pct, strain_pct].map(all => ofUnit(all, unit, pillars.length));
  return pillars.map((name, k) => [name, words(ohm[k] / 1e3, 3), words(change[k], 2), words(strain[k] ?? Infinity, 1)]);
}

// what acts on a sensor is unknown: beside what is found stand half-widths that hold 68 % of the errors

export const forcesHead = isFollowed => ["[N]", ...(isFollowed ? ["decoupled", "±"] : ["applied", "decoupled", "error"])];

export function unitForces({ applied_n, force_n, half_width_n, moment_nmm, moment_half_width_nmm }, unit, isFollowed) {
  const applied = three(applied_n, unit), found = three(force_n, unit), half = three(half_width_n, unit);
  if (!isFollowed) {
    return AXES.map((name, k) =>
      [`F${name}`, words(applied[k], 1), words(found[k], 1), words(minus(found[k], applied[k]), 2)]);
  }
  const moments = three(moment_nmm, unit), unsure = three(moment_half_width_nmm, unit);
  return [...AXES.map((name, k) => [`F${name}`, words(found[k], 1), words(half[k] ?? null, 2)]),
    ...moments.map((moment, k) => [`M${AXES[k]} [N mm]`, words(moment, 0), words(unsure[k] ?? null, 1)])];
}

export const tableHead = ({ pillars }, isFollowed) => ["unit", ...pillars.map(name => `R${name}`),
  ...AXES.flatMap(axis => (isFollowed ? [`F${axis}`, "±"] : [`F${axis} appl.`, `F${axis} dec.`]))];

export function tableRows({ cols, pillars }, { resistance_ohm, applied_n, force_n, half_width_n }, isFollowed) {
  return Array.from({ length: force_n.length / 3 }, (_, unit) => {
    const found = three(force_n, unit), ohms = ofUnit(resistance_ohm, unit, pillars.length);
    const other = three(isFollowed ? half_width_n : applied_n, unit).map(value => words(value, isFollowed ? 2 : 1));
    return [`${Math.floor(unit / cols)}, ${unit % cols}`, ...ohms.map(ohm => words(ohm / 1e3, 3)),
      ...AXES.flatMap((_, k) => {
        const pair = [other[k] ?? words(null), words(found[k], 1)];
        return isFollowed ? pair.reverse() : pair;
      })];
  });
}

// the largest strain [%] and whose it is; of a pillar that turned over it is unknown

export function largestStrain({ cols, pillars }, { strain_pct }) {
  const strains = strain_pct.map(strain => strain ?? Infinity), most = Math.max(...strains), at = strains.indexOf(most);
  const unit = Math.floor(at / pillars.length);
  return [most, `${pillars[at % pillars.length]} pillar of row ${Math.floor(unit / cols)}, col ${unit % cols}`];
}

export function missed({ applied_n, force_n }) {
  const errors = force_n.map((found, at) => minus(found, applied_n[at])).filter(error => error !== null);
  const square = errors.reduce((sum, error) => sum + error * error, 0) / errors.length;
  return errors.length ? `all forces missed by ${words(Math.sqrt(square), 2)} N (rms)` : "";
}

export function csv({ rows, cols, pitch_mm, pillars }, { traction_mpa, resistance_ohm, applied_n, force_n }) {
  const head = ["row", "col", "x_mm", "y_mm", ...AXES.map(axis => `traction_${axis}_mpa`),
    ...pillars.map(pillar => `resistance_${pillar}_ohm`), ...AXES.map(axis => `applied_f${axis}_n`),
    ...AXES.map(axis => `decoupled_f${axis}_n`)];
  const lines = Array.from({ length: rows * cols }, (_, unit) => {
    const row = Math.floor(unit / cols), col = unit % cols;
    const place = [pitch_mm * (col - (cols - 1) / 2), pitch_mm * (row - (rows - 1) / 2)];
    return [row, col, ...place, ...three(traction_mpa, unit), ...ofUnit(resistance_ohm, unit, pillars.length),
      ...three(applied_n, unit), ...three(force_n, unit)];
  });
  return [head, ...lines].map(line => line.join()).join("\n") + "\n";
}
