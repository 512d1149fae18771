// Columns over the frame number, one small plot each; the frame under the pointer is marked in all of them.

function startCurves(holder, data, chart, look) {
  const groupOf = new Map(chart.points.map((point) => [point.label, point.group]));
  const labels = chart.points.map((point) => point.label);
  const rank = new Map(labels.map((label) => [label, labels.filter((other) => groupOf.get(other) === groupOf.get(label)).indexOf(label)]));
  const plots = data.curves.map((curve) => makeCurvePlot(curve));
  if (data.disoccluded) plots.push(makeCurvePlot({ name: "disoccluded", title: "disoccluded share of the receivers", unit: "%", lines: null }));
  holder.replaceChildren(makeLegend(chart.groups.map((name) => ({ name, index: look(name) }))),
    el("div", { class: "curves" }, plots.map((plot) => plot.node)));

  function mark(frame) { for (const plot of plots) plot.mark(frame); }

  function makeCurvePlot(curve) {
    const area = el("div", { class: "plot-area", tabindex: 0, role: "group" });
    const node = el("figure", { class: "curve", "data-column": curve.name }, el("figcaption", {}, axisTitle(curve)), area);
    const state = { width: 0, x: null, y: null, box: null, at: null };

    function lines() {
      if (!curve.lines) return [["every technique", data.disoccluded.map((share) => share === null ? null : 100 * share)]];
      return Object.entries(curve.lines).filter(([label]) => !shown.hidden.has(groupOf.get(label)));
    }

    function draw() {
      const { width } = state, height = curve.lines ? 230 : 150;
      if (!width) return;
      const box = state.box = { left: 46, right: width - 10, top: 10, bottom: height - 26 };
      const all = curve.lines ? Object.values(curve.lines).flat() : lines()[0][1];
      state.x = linearScale(data.frames, box.left + 4, box.right - 4);
      state.x.position = (frame) => box.left + 4 + (box.right - box.left - 8) * (frame - data.frames[0]) / Math.max(1, data.frames.at(-1) - data.frames[0]);
      state.x.ticks = linearTicks(data.frames[0], data.frames.at(-1)).filter((tick) => Number.isInteger(tick.value));
      state.y = curve.lines ? makeScale(all.filter((value) => value !== null), box.bottom, box.top) : linearScale([0, ...all.filter((value) => value !== null)], box.bottom, box.top);
      const root = svg("svg", { width, height, viewBox: `0 0 ${width} ${height}`, "aria-hidden": "true" }, drawAxes(state.x, state.y, box, {}));
      for (const [label, values] of lines()) root.append(...drawLine(label, values, box));
      root.append(svg("line", { class: "cross", y1: box.top, y2: box.bottom, visibility: "hidden" }));
      area.replaceChildren(root);
      area.setAttribute("aria-label", `${axisTitle(curve)} over frames ${data.frames[0]} to ${data.frames.at(-1)}; left and right read single frames`);
    }

    function drawLine(label, values, box) {
      const places = values.map((value, i) => value === null ? null : [state.x.position(data.frames[i]), state.y.position(value)]);
      if (!curve.lines) {
        const known = places.filter(Boolean);
        return [svg("path", { class: "area", d: `M${known[0][0]},${box.bottom}L${known.map((p) => p.join(",")).join("L")}V${box.bottom}Z` })];
      }
      const index = look(groupOf.get(label)), known = places.filter(Boolean);
      const line = svg("path", { class: "line", "data-label": label, stroke: colorOf(index), "stroke-dasharray": DASHES[(Math.floor(index / COLOR_COUNT) + rank.get(label)) % DASHES.length] || null, d: `M${known.map((p) => p.join(",")).join("L")}` });
      const dots = known.length < values.length || known.length === 1
        ? known.map(([x, y]) => svg("path", { class: "dot", "data-label": label, fill: colorOf(index), d: markerOf(index), transform: `translate(${x},${y}) scale(0.55)` })) : [];
      return [line, ...dots];
    }

    function point(frameIndex, event) {
      mark(frameIndex);
      const rows = lines().map(([label, values]) => ({ label, value: values[frameIndex] })).filter((row) => row.value !== null && row.value !== undefined);
      rows.sort((a, b) => b.value - a.value);
      const frame = area.getBoundingClientRect();
      const height = event ? event.clientY - frame.top : (state.box.top + state.box.bottom) / 2;
      const near = rows.reduce((best, row) => {
        const away = Math.abs(state.y.position(row.value) - height);
        return !best || away < best.away ? { ...row, away } : best;
      }, null);
      area.firstChild.classList.toggle("has-near", Boolean(near && curve.lines));
      for (const shape of area.querySelectorAll("[data-label]")) shape.classList.toggle("near", shape.dataset.label === near?.label);
      const place = rows.findIndex((row) => row.label === near?.label), first = clamp(place - 7, 0, Math.max(0, rows.length - 15));
      tooltip.show(el("div", { class: "card-body" }, el("strong", {}, `frame ${data.frames[frameIndex]}`),
        rows.length ? el("table", {}, el("tbody", {}, rows.slice(first, first + 15).map((row) => el("tr", { class: row.label === near.label ? "chosen" : null },
          el("th", { scope: "row" }, curve.lines && swatch(look(groupOf.get(row.label)), 12), " ", row.label), el("td", {}, number(row.value)))))) : el("p", { class: "soft" }, "not measured on this frame")),
        frame.left + state.x.position(data.frames[frameIndex]), event ? event.clientY : frame.top + 60);
    }

    function leave() {
      mark(null);
      tooltip.hide();
      area.firstChild?.classList.remove("has-near");
    }

    area.addEventListener("pointermove", (event) => {
      if (!state.box) return;
      const px = event.clientX - area.getBoundingClientRect().left;
      const away = data.frames.map((frame) => Math.abs(state.x.position(frame) - px));
      point(state.at = away.indexOf(Math.min(...away)), event);
    });
    area.addEventListener("pointerleave", leave);
    area.addEventListener("blur", leave);
    area.addEventListener("keydown", (event) => {
      if (event.key !== "ArrowLeft" && event.key !== "ArrowRight") return;
      state.at = state.at === null ? 0 : clamp(state.at + (event.key === "ArrowRight" ? 1 : -1), 0, data.frames.length - 1);
      point(state.at, null);
      event.preventDefault();
    });
    shown.watch(draw);
    onWidth(area, (width) => { state.width = width; draw(); });
    return {
      node,
      mark(frameIndex) {
        const cross = area.querySelector(".cross");
        if (!cross) return;
        cross.setAttribute("visibility", frameIndex === null ? "hidden" : "visible");
        if (frameIndex === null) return;
        for (const end of ["x1", "x2"]) cross.setAttribute(end, state.x.position(data.frames[frameIndex]));
      },
    };
  }
}
