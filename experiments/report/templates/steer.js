// Pointer, wheel and keys of the viewer's stage and of the border between before and after.

function steerStage({ stage, handle, state, names, frames, set, redraw, spot }) {
  const pointers = new Map();
  const inStage = (event) => {
    const frame = stage.getBoundingClientRect();
    return [event.clientX - frame.left, event.clientY - frame.top];
  };
  const pixelAt = (px, py) => {
    const [x, y] = spot().imageAt(px, py).map(Math.floor);
    return x >= 0 && y >= 0 && x < spot().width && y < spot().height ? [x, y] : null;
  };
  const moveBorder = (share) => { state.wipe = clamp(share, 0, 1); redraw(); };
  const turn = (by) => set({ label: names[(names.indexOf(state.label) + by + names.length) % names.length] });
  const turnFrame = (by) => set({ frame: frames[clamp(frames.indexOf(state.frame) + by, 0, frames.length - 1)] });

  stage.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    pointers.set(event.pointerId, inStage(event));
    stage.setPointerCapture(event.pointerId);
  });
  stage.addEventListener("pointermove", (event) => {
    const at = inStage(event), before = pointers.get(event.pointerId);
    state.pixel = pixelAt(...at);
    if (before && pointers.size === 1) spot().panBy(at[0] - before[0], at[1] - before[1]);
    if (before && pointers.size === 2) pinch(event.pointerId, before, at);
    if (before) pointers.set(event.pointerId, at);
    redraw();
  });
  for (const name of ["pointerup", "pointercancel"]) stage.addEventListener(name, (event) => pointers.delete(event.pointerId));
  stage.addEventListener("pointerleave", () => { state.pixel = null; redraw(); });

  function pinch(moved, before, at) {
    const [, other] = [...pointers].find(([id]) => id !== moved);
    const spread = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
    spot().zoomBy(spread(at) / Math.max(1, spread(before)), (at[0] + other[0]) / 2, (at[1] + other[1]) / 2);
    spot().panBy((at[0] - before[0]) / 2, (at[1] - before[1]) / 2);
  }

  // The page scrolls on unless the picture has the focus, or there is nothing left to zoom.
  stage.addEventListener("wheel", (event) => {
    if (document.activeElement !== stage && !event.ctrlKey) return;
    const out = event.deltaY > 0, before = spot().zoom;
    spot().zoomBy(Math.exp(-clamp(event.deltaY, -200, 200) * 0.002), ...inStage(event));
    if (out && spot().zoom === before && !event.ctrlKey) return;
    event.preventDefault();
    redraw();
  }, { passive: false });
  stage.addEventListener("dblclick", (event) => { spot().zoomBy(event.shiftKey ? 0.5 : 2, ...inStage(event)); redraw(); });

  const modes = Object.keys(MODES);
  stage.addEventListener("keydown", (event) => {
    if (event.target !== stage || event.ctrlKey || event.metaKey || event.altKey) return;
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (arrows && event.shiftKey) spot().panBy(-48 * arrows[0], -48 * arrows[1]);
    else if (arrows) arrows[0] ? turn(arrows[0]) : turnFrame(arrows[1]);
    else if (event.key === "+" || event.key === "=") spot().zoomBy(1.5);
    else if (event.key === "-") spot().zoomBy(1 / 1.5);
    else if (event.key === "0") spot().reset();
    else if (event.key === " ") set({ label: state.label === REFERENCE || !names.includes(REFERENCE) ? state.before : REFERENCE });
    else if (event.key === "b") set({ wipe: state.wipe === null ? 0.5 : null });
    else if (modes[event.key - 1]) set({ mode: modes[event.key - 1] });
    else return;
    event.preventDefault();
    redraw();
  });

  handle.addEventListener("pointerdown", (event) => {
    event.stopPropagation();
    handle.setPointerCapture(event.pointerId);
    handle.focus();
    event.preventDefault();
  });
  handle.addEventListener("pointermove", (event) => {
    event.stopPropagation();
    if (handle.hasPointerCapture(event.pointerId)) moveBorder(inStage(event)[0] / stage.clientWidth);
  });
  handle.addEventListener("keydown", (event) => {
    const step = event.shiftKey ? 0.1 : 0.02;
    const to = { ArrowLeft: state.wipe - step, ArrowRight: state.wipe + step, Home: 0, End: 1, PageDown: state.wipe - 0.1, PageUp: state.wipe + 0.1 }[event.key];
    if (to === undefined) return;
    moveBorder(to);
    event.preventDefault();
  });
}
