// Files from the page and back: what is shown, under a name of its own.

export function save(name, content) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content instanceof Blob ? content : new Blob([content]));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

// the picture as it is shown; below it a line of notes and its keys, as many beside each other as have room

export function savePicture(image, { legend, scale_note, strain_note }, root) {
  const KEY = 230, LENGTH = 200, style = getComputedStyle(root), ratio = image.naturalWidth / image.clientWidth;
  const wide = image.clientWidth, top = image.naturalHeight / ratio, beside = Math.max(1, Math.floor(wide / KEY));
  const canvas = document.createElement("canvas"), context = canvas.getContext("2d");
  canvas.width = image.naturalWidth;
  canvas.height = Math.round(ratio * (top + 26 + 52 * Math.ceil(legend.length / beside)));
  context.fillStyle = style.getPropertyValue("--stage");
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.drawImage(image, 0, 0);
  context.scale(ratio, ratio);
  const ink = context.fillStyle = style.getPropertyValue("--ink");
  context.font = "12px sans-serif";
  context.fillText([scale_note, strain_note].filter(Boolean).join(" · "), 16, top + 16, wide - 32);
  legend.forEach(({ title, colours, labels }, place) => {
    const left = 16 + KEY * (place % beside), line = top + 38 + 52 * Math.floor(place / beside);
    const shades = context.createLinearGradient(left, 0, left + LENGTH, 0);
    colours.forEach((colour, k) => shades.addColorStop(k / (colours.length - 1), colour));
    context.fillText(title, left, line, LENGTH);
    context.fillStyle = shades;
    context.fillRect(left, line + 6, LENGTH, 10);
    context.fillStyle = ink;
    context.textAlign = "center";
    for (const [share, words] of labels) context.fillText(words, left + share * LENGTH, line + 30);
    context.textAlign = "left";
  });
  canvas.toBlob(blob => save("tripillar.png", blob));
}

export async function loadState(input, take) {
  const [file] = input.files;
  input.value = "";  // the same file can be chosen again
  if (!file) return;
  try {
    take(JSON.parse(await file.text()));
  } catch {
    take(null);  // the server says what a state is
  }
}
