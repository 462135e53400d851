// Places pictures one below the other where the window is higher than wide.

const many = matchMedia('(max-aspect-ratio: 1)');
function stack() {
  const all = window.global.renderWindow?.getRenderers() ?? [];
  const renderers = all.filter(one => one.getActors().length);
  const n = renderers.length;
  if (n < +getComputedStyle(document.querySelector('main')).getPropertyValue('--n')) return setTimeout(stack, 50);
  renderers.forEach((one, k) => one.setViewport(
    ...(many.matches ? [0, 1 - (k + 1) / n, 1, 1 - k / n] : [k / n, 0, (k + 1) / n, 1])));
  window.global.renderWindow.render();
}
many.addEventListener('change', stack);
stack();
