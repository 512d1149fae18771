// Techniques at one spot: flip through them, wipe between one and the reference, read single pixels.

const MODES = { shaded: "Shaded", visibility: "Visibility", error: "Error", standard_error: "Standard error" };
const MODE_NOUNS = { shaded: "shaded picture", visibility: "visibility", error: "error map", standard_error: "standard error" };

const viewer = {
  data: null,
  has(label) { return Boolean(this.data?.labels.includes(label)); },
  open(label) {
    this.select(label);
    document.getElementById("look").scrollIntoView({ behavior: "smooth", block: "start" });
    this.stage.focus({ preventScroll: true });
  },
};

function startViewer(holder, data, chart) {
  const palette = bytesOfHex(data.errorColours);
  const colours = new Colours(palette), frames = data.frames.map((frame) => new FieldFrame(frame, colours));
  const names = [...(data.reference ? [REFERENCE] : []), ...data.labels];
  const title = (label) => label === REFERENCE ? "reference" : label;
  // First a technique of the middle of the front: one that is worth its time, and whose error is to be seen.
  const front = chart ? paretoFront(chart.points.filter((point) => point.values.frame_ms && point.values.rmse && data.labels.includes(point.label)), "frame_ms", "rmse") : [];
  const first = front[front.length >> 1]?.label ?? data.labels[0];
  const state = { frame: frames[0], label: first, before: first, against: data.reference ? REFERENCE : data.labels.at(-1), mode: "visibility", wipe: null, pixel: null };
  let spot = new Spot(frames[0].width, frames[0].height), waiting = false;

  // ---- The parts ----
  const canvas = el("canvas", { "aria-hidden": "true" });
  const handle = el("div", { class: "wipe-handle", role: "slider", tabindex: 0, "aria-orientation": "horizontal", "aria-valuemin": 0, "aria-valuemax": 100, "aria-label": "Border between technique and reference" });
  const left = el("span", { class: "name left" }), right = el("span", { class: "name right" }), missing = el("p", { class: "missing" });
  const stage = el("div", { class: "stage", tabindex: 0, role: "application", "aria-describedby": "viewer-keys" }, canvas, left, right, missing, handle);
  const modeButtons = Object.entries(MODES).map(([mode, text]) => el("button", { type: "button", "data-mode": mode, onclick: () => set({ mode }) }, text));
  const wipe = el("button", { type: "button", "data-action": "wipe", onclick: () => set({ wipe: state.wipe === null ? 0.5 : null }) }, "Before / after");
  const frameSelect = el("select", { onchange: (event) => set({ frame: frames[event.target.selectedIndex] }) }, frames.map((f) => el("option", {}, String(f.frame))));
  const againstSelect = el("select", { onchange: (event) => set({ against: names[event.target.selectedIndex] }) }, names.map((name) => el("option", {}, title(name))));
  againstSelect.selectedIndex = names.indexOf(state.against);
  const zoomText = el("output", { class: "zoom", "aria-label": "Zoom" });
  const step = (text, name, factor) => el("button", { type: "button", "aria-label": name, "data-action": name, onclick: () => { factor ? spot.zoomBy(factor) : spot.reset(); redraw(); } }, text);
  const bar = el("div", { class: "bar-place" });
  const cells = ["pixel", "technique", "reference", "difference", "standard error"].map((name) => [name, el("dd", { "data-readout": name })]);
  const readout = el("dl", { class: "readout", "aria-label": "Values of the pixel under the pointer" }, cells.map(([name, node]) => el("div", {}, el("dt", {}, name), node)));
  const strip = names.map((name) => {
    const numbers = chart?.points.find((point) => point.label === name)?.values ?? {};
    const facts = [numbers.rmse && number(numbers.rmse[0]), numbers.frame_ms && `${number(numbers.frame_ms[0])} ms`].filter(Boolean).join(" · ");
    return el("button", { type: "button", class: "thumb", "data-label": title(name), title: facts && `${title(name)}: median RMSE and frame time`, onclick: () => viewer.select(name) },
      el("canvas", { "aria-hidden": "true" }), el("span", {}, title(name)), el("small", { "data-facts": facts }));
  });
  holder.replaceChildren(
    el("div", { class: "controls" },
      el("label", { class: "pick" }, el("span", {}, "frame"), frameSelect),
      el("div", { class: "segments", role: "group", "aria-label": "What is shown" }, modeButtons),
      el("div", { class: "segments" }, wipe), el("label", { class: "pick" }, el("span", {}, "against"), againstSelect),
      el("div", { class: "segments zooms", role: "group", "aria-label": "Zoom" }, step("−", "zoom out", 1 / 1.5), zoomText, step("+", "zoom in", 1.5), step("Fit", "fit", 0))),
    stage, readout, bar,
    el("div", { class: "strip", role: "group", "aria-label": "Techniques, all at the same spot" }, strip),
    el("p", { class: "soft keys", id: "viewer-keys" }, "With the picture in focus: ← → technique · space reference · ↑ ↓ frame · + − 0 or the wheel zoom · shift and arrows, or dragging, move · 1 to 4 what is shown · b before / after. From 38 times on, pixels show their values."));

  // ---- What is shown ----
  function set(change) {
    Object.assign(state, change);
    if (state.label !== REFERENCE) state.before = state.label;
    if (change.frame) {
      if (change.frame.width !== spot.width || change.frame.height !== spot.height) spot = new Spot(change.frame.width, change.frame.height);
      frameSelect.selectedIndex = frames.indexOf(state.frame);
      resize(stage.clientWidth);
      state.frame.load().then(() => { refresh(); }, (error) => { missing.textContent = `This browser cannot unpack the images (${error.message}).`; });
      return;
    }
    refresh();
  }

  function refresh() {
    for (const button of modeButtons) {
      const mode = button.dataset.mode, possible = names.some((name) => state.frame.has(name, mode));
      button.setAttribute("aria-pressed", String(mode === state.mode));
      button.disabled = !possible;
    }
    if (modeButtons.find((button) => button.dataset.mode === state.mode).disabled && state.mode !== "visibility" && state.frame.numbers) return set({ mode: "visibility" });
    wipe.setAttribute("aria-pressed", String(state.wipe !== null));
    bar.replaceChildren(barOf(state.mode, palette) ?? "");
    strip.forEach((button, i) => button.setAttribute("aria-pressed", String(names[i] === state.label)));
    stage.setAttribute("aria-label", `${title(state.label)}, ${MODES[state.mode].toLowerCase()}, frame ${state.frame.frame}`);
    redraw();
  }

  // The reference has no error and is not shaded: beside those it shows what it is made of.
  function modeOf(label) {
    return label === REFERENCE && !state.frame.has(label, state.mode) ? "visibility" : state.mode;
  }

  function named(label) {
    return modeOf(label) === state.mode ? title(label) : `${title(label)}, visibility`;
  }

  function redraw() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; draw(); });
  }

  function draw() {
    const width = stage.clientWidth, height = stage.clientHeight;
    if (!width || !state.frame.numbers) return;
    const wiping = state.wipe !== null, border = wiping ? state.wipe * width : width;
    const before = wiping ? state.before : state.label;
    const context = fineContext(canvas, width, height);
    const part = (label, from, to) => {
      const picture = state.frame.picture(label, modeOf(label), redraw);
      if (!picture || to <= from) return;
      context.save();
      context.beginPath();
      context.rect(from, 0, to - from, height);
      context.clip();
      drawSpot(context, picture, spot, width, height);
      if (modeOf(label) !== "shaded") writeValues(context, spot, from, to, (x, y) => pixelText(label, x, y));
      context.restore();
    };
    part(before, 0, border);
    if (wiping) part(state.against, border, width);
    if (state.pixel) outline(context);
    const lacks = [before, ...(wiping ? [state.against] : [])].filter((label) => !state.frame.has(label, modeOf(label)));
    missing.textContent = lacks.length ? `${lacks.map(title).join(" and ")} ${lacks.length > 1 ? "have" : "has"} no ${MODE_NOUNS[state.mode]} here.` : "";
    left.textContent = named(before);
    right.textContent = wiping ? named(state.against) : "";
    handle.hidden = !wiping;
    handle.style.left = `${border}px`;
    handle.setAttribute("aria-valuenow", String(Math.round(100 * (state.wipe ?? 0.5))));
    handle.setAttribute("aria-valuetext", `${title(before)} on the left ${Math.round(100 * (state.wipe ?? 0.5))} percent, ${title(state.against)} on the right`);
    zoomText.textContent = spot.zoom >= 10 ? `${spot.zoom.toFixed(0)}×` : `${spot.zoom.toFixed(2)}×`;
    stage.classList.toggle("zoomed", spot.zoom > spot.fit * 1.001);
    Object.assign(stage.dataset, { zoom: spot.zoom, x: spot.x, y: spot.y, label: title(state.label), mode: state.mode, frame: state.frame.frame });
    const wide = strip[0].firstChild.clientWidth, high = Math.round(wide * height / width);
    strip.forEach((button, i) => drawThumb(button.firstChild, names[i], wide, high, wide / width));
    read();
  }

  function drawThumb(small, label, wide, high, scale) {
    if (!wide) return;
    if (small.dataset.high !== String(high)) small.style.height = `${small.dataset.high = high}px`;
    const context = fineContext(small, wide, high), picture = state.frame.picture(label, modeOf(label), redraw);
    if (picture) drawSpot(context, picture, spot, wide, high, scale);
  }

  function pixelText(label, x, y) {
    const mode = modeOf(label), error = mode === "error";
    const own = state.frame.value(label, mode === "standard_error" ? "standard_error" : "visibility", x, y);
    const value = error ? own - state.frame.value(REFERENCE, "visibility", x, y) : own;
    return { text: Number.isFinite(value) ? (error ? signed(value, 3) : value.toFixed(3)) : "", dark: error || mode === "standard_error" ? Math.abs(value) < 0.6 : value < 0.5 };
  }

  function outline(context) {
    const [px, py] = spot.windowAt(...state.pixel), size = Math.max(spot.zoom, 3);
    context.lineWidth = 1;
    context.strokeStyle = "#000";
    context.strokeRect(px - 1.5, py - 1.5, size + 3, size + 3);
    context.strokeStyle = "#fff";
    context.strokeRect(px - 0.5, py - 0.5, size + 1, size + 1);
  }

  // The pixel under the pointer, or the one in the middle while there is none.
  function read() {
    const [x, y] = state.pixel ?? [Math.floor(spot.x), Math.floor(spot.y)], label = state.wipe === null ? state.label : state.before;
    const value = (name, kind = "visibility") => state.frame.value(name, kind, x, y);
    const own = value(label), truth = value(REFERENCE);
    const texts = { pixel: `${x}, ${y}`, technique: text(own), reference: text(truth), difference: Number.isFinite(own - truth) ? signed(own - truth, 4) : "–", "standard error": text(value(label, "standard_error")) };
    const exact = { technique: own, reference: truth, difference: own - truth, "standard error": value(label, "standard_error") };
    for (const [name, node] of cells) {
      node.textContent = texts[name];
      node.dataset.value = Number.isFinite(exact[name]) ? exact[name] : "";
    }
    readout.querySelectorAll("dt")[1].textContent = title(label);
    strip.forEach((button, i) => { button.lastChild.textContent = (state.pixel && valueOf(names[i])) || button.lastChild.dataset.facts || "\u00a0"; });

    // What every technique has at the pixel under the pointer, and by how much that is off.
    function valueOf(name) {
      const seen = value(name), error = name === REFERENCE ? NaN : seen - truth;
      return text(seen) + (Number.isFinite(error) ? ` (${signed(error, 3)})` : "");
    }
  }

  function text(value) { return Number.isFinite(value) ? value.toFixed(4) : "–"; }

  function resize(width) {
    if (!width) return;
    const height = clamp(Math.round(width * spot.height / spot.width), 120, Math.max(260, Math.round(window.innerHeight * 0.74)));
    stage.style.height = `${height}px`;
    spot.setWindow(width, height);
    redraw();
  }

  Object.assign(viewer, { data, stage, select: (label) => set({ label }) });
  steerStage({ stage, handle, state, names, frames, set, redraw, spot: () => spot });
  onWidth(stage, resize);
  document.addEventListener("visibilitychange", redraw);
  set({ frame: frames[Math.floor((frames.length - 1) / 2)] });
}
