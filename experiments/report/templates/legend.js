// Buttons that show and hide groups of points, labels or techniques, in all charts.

function swatch(index, size = 16) {
  return svg("svg", { width: size, height: size, viewBox: "-9 -9 18 18", "aria-hidden": "true" },
    svg("path", { d: markerOf(index), fill: colorOf(index) }));
}

// groups: [{name, index}]
function makeLegend(groups) {
  const buttons = groups.map(({ name, index }) => el("button", {
    type: "button", class: "entry", "aria-pressed": "true", "data-group": name,
    title: "Click: show or hide. Shift and click: show this one alone.",
    onclick: (event) => {
      if (!event.shiftKey) return shown.toggle(name);
      const others = groups.map((entry) => entry.name).filter((other) => other !== name);
      const alone = !shown.hidden.has(name) && others.every((other) => shown.hidden.has(other));
      shown.set(alone ? [] : others);
    },
  }, swatch(index), el("span", {}, name)));
  const all = el("button", { type: "button", class: "plain", onclick: () => shown.set([]) }, "all");
  const none = el("button", { type: "button", class: "plain", onclick: () => shown.set(groups.map((group) => group.name)) }, "none");
  const node = el("div", { class: "legend", role: "group", "aria-label": "Techniques shown" }, buttons,
    el("span", { class: "both" }, all, none));
  shown.watch(() => {
    for (const button of buttons) button.setAttribute("aria-pressed", String(!shown.hidden.has(button.dataset.group)));
  });
  return node;
}
