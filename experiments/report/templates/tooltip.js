// The one tooltip of the page, kept inside the window.

const tooltip = {
  node: null,
  show(content, clientX, clientY) {
    this.node ??= document.body.appendChild(el("div", { id: "tooltip", role: "tooltip", class: "tooltip" }));
    this.node.replaceChildren(content);
    this.node.hidden = false;
    const { offsetWidth: width, offsetHeight: height } = this.node;
    const { clientWidth, clientHeight } = document.documentElement;
    let left = clientX + 16;
    if (left + width > clientWidth - 6) left = clientX - width - 16;
    this.node.style.left = `${clamp(left, 6, Math.max(6, clientWidth - width - 6))}px`;
    this.node.style.top = `${clamp(clientY - height / 3, 6, Math.max(6, clientHeight - height - 6))}px`;
  },
  hide() {
    if (this.node) this.node.hidden = true;
  },
};
document.addEventListener("keydown", (event) => { if (event.key === "Escape") tooltip.hide(); });
