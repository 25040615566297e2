// A texture on any page, under a pen, a finger, the mouse or the arrow keys:
//
//     <script type="module" src="foten-pad.js"></script>
//     <foten-pad src="denim.foten"></foten-pad>
//
// Attributes: `src`, a texture file; `force`, 0 to 1, of what has no pressure; `volume` in dB. Events: `ready`, whose detail is what
// the texture says of itself, and `refused`, whose detail is a line for people. The files beside this one have to be on the same host.
import { Pad } from "./pad.js";
import { painted } from "./painter.js";
import { cardOf } from "./shelf.js";
import { PageSound } from "./sound.js";

const style = new CSSStyleSheet(); // without weight: any rule of the page's own goes before it
style.replaceSync(`
  :where(foten-pad) { display: block; height: 16rem; position: relative; }
  :where(foten-pad[data-refused])::after { content: attr(data-refused); position: absolute; inset: 0; display: grid; place-content: center; padding: 1rem; text-align: center; pointer-events: none; }
  :where(foten-pad > canvas) { display: block; width: 100%; height: 100%; touch-action: none; user-select: none; -webkit-user-select: none; cursor: crosshair; }`);
document.adoptedStyleSheets.push(style);

const LABEL = "Surface. Stroke it with a pen, a finger or the mouse; or with the arrow keys, Shift for faster, Space to press harder.";

export class FotenPad extends HTMLElement {
  static observedAttributes = ["src", "force", "volume"];

  connectedCallback() {
    if (this.pad) return;
    this.sound = new PageSound();
    this.loads = new Map(); // by src: what the worklet says of a texture
    const canvas = this.querySelector("canvas") ?? this.appendChild(document.createElement("canvas"));
    if (!canvas.hasAttribute("aria-label"))
      for (const [name, value] of Object.entries({ tabindex: "0", role: "application", "aria-label": LABEL })) canvas.setAttribute(name, value);
    this.pad = new Pad(canvas, (...event) => this.sound.push(...event));
    this.pad.dispatch = () => this.begin();
    canvas.addEventListener("pointerup", () => this.begin()); // a finger is a tap only when it leaves
    this.sound.addEventListener("failed", ({ detail }) => this.emit("refused", detail));
    for (const name of FotenPad.observedAttributes) this.attributeChangedCallback(name, null, this.getAttribute(name));
  }

  disconnectedCallback() {
    this.sound.context?.suspend(); // a touch goes on, where the element comes back
  }

  attributeChangedCallback(name, _, value) {
    if (!this.pad || value === null) return;
    if (name === "force") this.pad.force = Number(value);
    else if (name === "volume") this.sound.setVolume(Number(value));
    else this.opening = this.fetched(value);
  }

  get src() {
    return this.getAttribute("src");
  }

  set src(value) {
    this.setAttribute("src", value);
  }

  emit(type, detail) {
    this.toggleAttribute("data-refused", false);
    if (type === "refused" && this.src !== null) {
      console.error(`foten-pad: ${detail}`);
      if (!this.texture) this.dataset.refused = detail; // where there is nothing to stroke, the line says why
    }
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }

  /** Fetch a texture file and show it; it sounds from the next touch on, or at once where another one does already. */
  async fetched(src) {
    this.texture = null;
    try {
      const answer = await fetch(src);
      if (!answer.ok) throw new Error(`${src} could not be fetched: ${answer.status} ${answer.statusText}`);
      const bytes = await answer.arrayBuffer(), card = cardOf(bytes);
      if (card.hasGraph) throw new Error(`${src} has a network that only a server runs: foten serve ${src}`);
      const { canvas, mm } = await painted(bytes, card.texture);
      if (this.src !== src) return; // another one was asked for
      this.texture = { src, bytes };
      this.pad.setTile(canvas, mm);
      this.toggleAttribute("data-refused", false);
      if (this.sound.running) this.begin(); // which waits for this
    } catch (error) {
      this.emit("refused", error.message);
    }
  }

  /** Begin to sound, while the browser still knows of a tap. */
  async begin() {
    try {
      await this.sound.start();
      await this.opening;
      const { texture } = this;
      if (!texture || this.sound.id === texture.src) return;
      const info = await this.loaded(texture);
      if (this.texture !== texture || this.sound.id === texture.src) return; // another one was asked for, or this one by another touch
      this.sound.use(texture.src);
      this.emit("ready", info);
    } catch (error) {
      this.emit("refused", error.message);
    }
  }

  /** Have a texture made ready, once. */
  loaded({ src, bytes }) {
    if (!this.loads.has(src)) this.loads.set(src, this.sound.load(src, bytes));
    this.loads.get(src).catch(() => this.loads.delete(src));
    return this.loads.get(src);
  }
}

customElements.define("foten-pad", FotenPad);
