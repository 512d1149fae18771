// Pictures of the contact sheet and the views: a click or Enter shows them large.

function startPictures(images) {
  const dialog = el("dialog", { class: "big", "aria-label": "Picture, large" });
  dialog.addEventListener("click", () => dialog.close());
  for (const image of images) {
    Object.assign(image, { tabIndex: 0 });
    image.setAttribute("role", "button");
    const open = () => {
      if (!dialog.isConnected) document.body.append(dialog);
      dialog.replaceChildren(el("figure", {}, el("img", { src: image.src, alt: image.alt }), el("figcaption", {}, image.alt)));
      dialog.showModal();
    };
    image.addEventListener("click", open);
    image.addEventListener("keydown", (event) => { if (event.key === "Enter") open(); });
  }
}

// On paper nothing can be opened any more.
window.addEventListener("beforeprint", () => { for (const node of document.querySelectorAll("main details")) node.open = true; });
