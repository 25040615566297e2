// The surface on the first page, and the gallery beside it.
import "./live/foten-pad.js";

const surface = document.querySelector("foten-pad"), said = document.querySelector("#live-said");
const buttons = [...document.querySelectorAll("#live-gallery button")];

for (const button of buttons)
  button.addEventListener("click", () => {
    surface.setAttribute("src", `live/textures/${button.value}.foten`);
    for (const other of buttons) other.setAttribute("aria-pressed", String(other === button));
    surface.querySelector("canvas").focus({ preventScroll: true });
    surface.begin().then(() => surface.pad.play?.());
  });
surface.addEventListener("refused", ({ detail }) => (said.textContent = detail));
