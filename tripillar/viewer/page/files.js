// Files from the page and back: what is shown, under a name of its own.

export function save(name, content) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content instanceof Blob ? content : new Blob([content]));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

// the picture as it is shown, with its keys and the factor of displacement below

export function savePicture(image, { legend, scale_note, strain_note }, root) {
  const style = getComputedStyle(root), ratio = image.naturalWidth / image.clientWidth, strip = 58 * ratio;
  const canvas = document.createElement("canvas"), context = canvas.getContext("2d");
  canvas.width = image.naturalWidth;
  canvas.height = image.naturalHeight + strip;
  context.fillStyle = style.getPropertyValue("--stage");
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.drawImage(image, 0, 0);
  context.scale(ratio, ratio);
  context.fillStyle = style.getPropertyValue("--ink");
  context.font = "12px sans-serif";
  const wide = canvas.width / ratio, top = image.naturalHeight / ratio, room = (wide - 32) / legend.length;
  legend.forEach(({ title, colours, labels }, place) => {
    const left = 16 + place * room, length = Math.min(room - 40, 260), ink = context.fillStyle;
    const shades = context.createLinearGradient(left, 0, left + length, 0);
    colours.forEach((colour, k) => shades.addColorStop(k / (colours.length - 1), colour));
    context.textAlign = "left";
    context.fillText(place ? title : `${title}, ${scale_note}${strain_note && `, ${strain_note}`}`, left, top + 12);
    context.fillStyle = shades;
    context.fillRect(left, top + 18, length, 10);
    context.fillStyle = ink;
    context.textAlign = "center";
    for (const [share, words] of labels) context.fillText(words, left + share * length, top + 42);
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
