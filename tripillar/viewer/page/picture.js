// The picture: what the server draws is shown; dragging turns, shift or two fingers move, the wheel or a pinch come nearer.

const DEGREES = 0.4;  // of turning, for a pixel
const WHEEL = 0.0015;  // of coming nearer, for a pixel of scrolling

export function watchPicture(place, image, send) {
  let waiting = null, isLoading = false;  // the newest picture only

  function next() {
    if (isLoading || !waiting) return;
    const url = URL.createObjectURL(waiting), done = () => {
      URL.revokeObjectURL(url);
      isLoading = false;
      next();
    };
    waiting = null;
    isLoading = true;
    image.onload = image.onerror = done;
    image.src = url;
  }

  function resize() {
    const ratio = Math.min(devicePixelRatio, 2), size = [place.clientWidth, place.clientHeight];
    if (size[0] && size[1]) send({ size: size.map(side => Math.min(Math.max(Math.round(ratio * side), 1), 4096)) });
  }
  new ResizeObserver(resize).observe(place);

  // moves between two frames of the screen are one message each

  const moved = { turn: [0, 0], move: [0, 0], nearer: 1 };
  let isSending = false;

  function gesture(name, change) {
    if (name === "nearer") moved.nearer *= change;
    else moved[name] = moved[name].map((value, axis) => value + change[axis]);
    if (isSending) return;
    isSending = true;
    requestAnimationFrame(() => {
      isSending = false;
      for (const kind of ["turn", "move"]) if (moved[kind].some(Boolean)) send({ [kind]: moved[kind] });
      if (moved.nearer !== 1) send({ nearer: Math.min(Math.max(moved.nearer, 0.1), 10) });
      Object.assign(moved, { turn: [0, 0], move: [0, 0], nearer: 1 });
    });
  }

  const fingers = new Map();
  const spread = () => {
    const [one, other] = [...fingers.values()];
    return Math.hypot(one.x - other.x, one.y - other.y);
  };

  place.onpointerdown = event => {
    if (event.target.closest("button")) return;
    place.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  };
  place.onpointerup = place.onpointercancel = event => fingers.delete(event.pointerId);
  place.onpointermove = event => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const x = event.clientX - before.x, y = event.clientY - before.y, apart = fingers.size === 2 && spread();
    Object.assign(before, { x: event.clientX, y: event.clientY });
    const isMove = event.shiftKey || event.buttons > 1 || fingers.size > 1;
    if (apart) gesture("nearer", spread() / apart);
    if (isMove) gesture("move", [x, -y].map(side => side / fingers.size / place.clientHeight));
    else gesture("turn", [DEGREES * x, -DEGREES * y]);
  };
  place.addEventListener("wheel", event => {
    event.preventDefault();
    gesture("nearer", Math.exp(-WHEEL * event.deltaY));
  }, { passive: false });
  place.oncontextmenu = event => event.preventDefault();

  return { resize, show(content) { waiting = content; next(); } };
}
