// Error against time: points with quartile whiskers, the Pareto front of what is shown, cards on hover, pins on click.

function makeScatter(holder, data, look) {
  const state = { x: data.x[0], y: data.y.includes("rmse") ? "rmse" : data.y[0], pins: new Map(), near: null };
  const order = data.points.map((point, i) => ({ ...point, key: i }));
  const pick = (which, label) => el("label", { class: "pick" }, el("span", {}, label),
    el("select", { "data-axis": which, onchange: (event) => { state[which] = event.target.value; draw(); } },
      data[which].map((name) => el("option", { value: name, selected: name === state[which] }, data.columns[name].title))));
  const plot = el("div", { class: "plot-area" });
  const pins = el("div", { class: "pins", "aria-live": "polite", "aria-label": "Pinned points" });
  const names = data.groups.map((name) => ({ name, index: look(name) }));
  holder.replaceChildren(
    el("div", { class: "controls" }, pick("y", "error"), pick("x", "time")), plot, makeLegend(names), pins);
  let width = 0, places = [];

  function visible() {
    return order.filter((point) => !shown.hidden.has(point.group) && state.x in point.values && state.y in point.values);
  }

  function draw() {
    if (!width) return;
    const points = visible(), narrow = width < 560;
    const height = narrow ? 340 : clamp(Math.round(width * 0.42), 400, 520);
    const box = { left: narrow ? 46 : 58, right: width - 14, top: 30, bottom: height - 46 };
    // The axes span everything, hidden or not, so that nothing moves while they are switched on and off.
    const spread = (name) => order.flatMap((point) => name in point.values ? point.values[name] : []);
    const x = makeScale(spread(state.x), box.left, box.right), y = makeScale(spread(state.y), box.bottom, box.top);
    const at = (point) => [x.position(point.values[state.x][0]), y.position(point.values[state.y][0])];
    const front = paretoFront(points, state.x, state.y);
    const root = svg("svg", {
      width, height, viewBox: `0 0 ${width} ${height}`, role: "group",
      "aria-label": `${data.columns[state.y].title} over ${data.columns[state.x].title}: ${points.length} points, ` +
        `Pareto front ${front.map((point) => point.label).join(", ")}`,
    });
    root.append(drawAxes(x, y, box, { x: axisTitle(data.columns[state.x]), y: axisTitle(data.columns[state.y]) }));
    const floor = data.floor[state.y];
    if (floor && y.kind === "log" && floor > y.low) {
      const top = Math.max(box.top, y.position(floor));
      root.append(svg("rect", { class: "floor", x: box.left, y: top, width: box.right - box.left, height: box.bottom - top }),
        svg("text", { class: "note", x: box.right - 6, y: box.bottom - 7, "text-anchor": "end" },
          narrow ? "not told from the reference" : "within 2 standard errors of the reference"));
    }
    if (front.length) root.append(svg("path", { class: "front", d: staircase(front.map(at), box) }));
    root.append(trails(points, at));
    places = points.map((point) => ({ point, at: at(point) }));
    const marks = svg("g", { class: "marks" });
    // A front that was judged by more than the medians stands where it is about what is shown.
    const judged = (point) => point.front !== null && state.y === "rmse" && state.x !== "shadow_ms";
    const best = points.filter((point) => judged(point) ? point.front : front.includes(point));
    for (const place of [...places].sort((a, b) => a.at[0] - b.at[0])) marks.append(mark(place, best.includes(place.point), x, y));
    marks.firstChild?.setAttribute("tabindex", 0);  // the arrow keys lead to the others
    root.append(marks, pointTexts(places, best, box));
    root.addEventListener("pointermove", (event) => hover(nearest(event, root), event));
    root.addEventListener("pointerleave", () => hover(null));
    root.addEventListener("click", (event) => { const found = nearest(event, root); if (found) togglePin(found.point); });
    root.addEventListener("keydown", walk);
    plot.replaceChildren(root);
  }

  function mark({ point, at }, onFront, x, y) {
    const [px, py] = at, index = look(point.group);
    const span = (scale, values) => values.length === 3 ? [scale.position(values[1]), scale.position(values[2])] : null;
    const across = span(x, point.values[state.x]), down = span(y, point.values[state.y]);
    const node = svg("g", {
      class: onFront ? "point on-front" : "point", tabindex: -1, role: "button", "data-label": point.label,
      "aria-pressed": String(state.pins.has(point.label)), "aria-describedby": "tooltip",
      "aria-label": `${point.label}: ${data.columns[state.y].title} ${number(point.values[state.y][0])}, ` +
        `${data.columns[state.x].title} ${number(point.values[state.x][0])}${onFront ? ", on the Pareto front" : ""}`,
      style: `color: ${colorOf(index)}`,
      onfocus: (event) => { if (event.target.matches(":focus-visible")) hover({ point, at }); },
      onblur: () => hover(null),
    },
    across && svg("path", { class: "whisker", d: `M${across[0]},${py}H${across[1]}M${across[0]},${py - 3}v6M${across[1]},${py - 3}v6` }),
    down && svg("path", { class: "whisker", d: `M${px},${down[0]}V${down[1]}M${px - 3},${down[0]}h6M${px - 3},${down[1]}h6` }),
    svg("path", { class: "marker", d: markerOf(index), transform: `translate(${px},${py})` }));
    node.point = { point, at };
    return node;
  }

  // Points of one technique at several parameters, joined from fast to slow.
  function trails(points, at) {
    const group = svg("g", { class: "trails", "aria-hidden": "true" });
    for (const name of new Set(points.map((point) => point.technique))) {
      const own = points.filter((point) => point.technique === name).map(at).sort((a, b) => a[0] - b[0]);
      if (own.length > 1) group.append(svg("path", { d: `M${own.map((p) => p.join(",")).join("L")}`, stroke: data.groups.includes(name) ? colorOf(look(name)) : "currentColor" }));
    }
    return group;
  }

  function nearest(event, root) {
    const frame = root.getBoundingClientRect(), reach = event.pointerType === "touch" ? 34 : 26;
    const px = event.clientX - frame.left, py = event.clientY - frame.top;
    let best = null, least = reach;
    for (const place of places) {
      const away = Math.hypot(place.at[0] - px, place.at[1] - py);
      if (away < least) [best, least] = [place, away];
    }
    return best;
  }

  function hover(place) {
    const label = place?.point.label ?? null;
    if (label === state.near) return;
    state.near = label;
    for (const node of plot.querySelectorAll(".point")) node.classList.toggle("near", node.dataset.label === label);
    plot.firstChild.classList.toggle("has-near", label !== null);
    if (!place) return tooltip.hide();
    const frame = plot.getBoundingClientRect();
    tooltip.show(pointCard(place.point, data, state), frame.left + place.at[0], frame.top + place.at[1]);
  }

  function walk(event) {
    const nodes = [...plot.querySelectorAll(".point")], here = nodes.indexOf(document.activeElement);
    if (event.key === "Enter" || event.key === " ") {
      if (here >= 0) togglePin(nodes[here].point.point);
    } else if (event.key === "ArrowRight" || event.key === "ArrowLeft") {
      const next = nodes[clamp(here + (event.key === "ArrowRight" ? 1 : -1), 0, nodes.length - 1)];
      next?.focus();
      for (const node of nodes) node.setAttribute("tabindex", node === next ? 0 : -1);
    } else return;
    event.preventDefault();
  }

  function togglePin(point) {
    if (state.pins.has(point.label)) {
      state.pins.get(point.label).remove();
      state.pins.delete(point.label);
    } else {
      const close = el("button", { type: "button", class: "close", "aria-label": `Unpin ${point.label}`, onclick: () => togglePin(point) }, "×");
      const card = el("article", { class: "pin", "data-label": point.label }, close, pointCard(point, data, state, true));
      state.pins.set(point.label, card);
      pins.append(card);
    }
    for (const node of plot.querySelectorAll(".point")) {
      node.setAttribute("aria-pressed", String(state.pins.has(node.dataset.label)));
    }
  }

  shown.watch(() => { hover(null); draw(); });
  onWidth(plot, (measured) => { width = measured; draw(); });
}

// Label, parameters, numbers and picture of a point.
function pointCard(point, data, state, pinned = false) {
  const rows = Object.entries(point.values)
    .filter(([name]) => pinned || [state.x, state.y, ...data.x, ...data.y.slice(0, 6)].includes(name))
    .map(([name, values]) => el("tr", { class: name === state.x || name === state.y ? "chosen" : null },
      el("th", { scope: "row" }, axisTitle(data.columns[name])), el("td", {}, number(values[0])),
      el("td", { class: "range" }, (pinned || name === state.x || name === state.y) && values.length === 3 && values[1] !== values[2] ? `${number(values[1])} to ${number(values[2])}` : "")));
  const details = Object.entries(point.details).map(([name, text]) => `${name} ${text}`).join(" · ");
  return el("div", { class: "card-body" },
    el("strong", {}, point.label), point.technique !== point.label && el("span", { class: "soft" }, ` ${point.technique}`),
    point.thumb && el("img", { src: point.thumb, alt: `${point.label}, rendered` }),
    details && el("p", { class: "details" }, details), el("table", {}, el("tbody", {}, rows)),
    pinned && viewer.has(point.label) && el("button", { type: "button", class: "plain", onclick: () => viewer.open(point.label) }, "Look at it"));
}

// The points that no other is at most as far from zero in both and nearer in one, from fast to slow.
function paretoFront(points, x, y) {
  const cost = (point) => point.values[x][0], error = (point) => Math.abs(point.values[y][0]);
  const beaten = (point) => points.some((other) => cost(other) <= cost(point) && error(other) <= error(point)
    && (cost(other) < cost(point) || error(other) < error(point)));
  return points.filter((point) => !beaten(point)).sort((a, b) => cost(a) - cost(b) || error(a) - error(b));
}

// What is reachable: at each time, the least error that some point gives by then.
function staircase(corners, box) {
  let path = `M${corners[0][0]},${box.top}`;
  for (const [px, py] of corners) path += `H${px}V${py}`;
  return `${path}H${box.right}`;
}

function textWidth(text) {
  textWidth.context ??= el("canvas").getContext("2d");
  textWidth.context.font = `12px ${getComputedStyle(document.body).fontFamily}`;
  return textWidth.context.measureText(text).width;
}

// Labels beside their points where there is room for them, those of the front first.
function pointTexts(places, front, box) {
  const group = svg("g", { class: "texts", "aria-hidden": "true" });
  const taken = places.map(({ at: [x, y] }) => [x - 7, y - 7, x + 7, y + 7]);
  const clear = (a) => a[0] >= box.left && a[2] <= box.right && a[1] >= box.top && a[3] <= box.bottom
    && !taken.some((b) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]);
  const rank = (place) => front.includes(place.point) ? 0 : 1;
  for (const place of [...places].sort((a, b) => rank(a) - rank(b))) {
    const [x, y] = place.at, wide = textWidth(place.point.label);
    for (const [dx, dy, anchor] of [[11, -8, "start"], [-11, -8, "end"], [11, 15, "start"], [-11, 15, "end"], [0, -13, "middle"], [0, 22, "middle"], [12, 4, "start"], [-12, 4, "end"]]) {
      const left = anchor === "start" ? x + dx : anchor === "end" ? x + dx - wide : x - wide / 2;
      const extent = [left, y + dy - 10, left + wide, y + dy + 3];
      if (!clear(extent)) continue;
      taken.push(extent);
      group.append(svg("text", { x: x + dx, y: y + dy, "text-anchor": anchor, class: rank(place) ? "faint" : null }, place.point.label));
      break;
    }
  }
  return group;
}
