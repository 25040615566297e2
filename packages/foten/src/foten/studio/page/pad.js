// The surface under the pen: events in millimetres out, the texture and the trail drawn.

const TRAIL_MS = 700;
const CLOSER = 2; // than it is, a surface is looked at
const LIGHTEST = 1e-3; // pressure of a pen that is down
const STEP_MS = 8; // of a stroke by keys
const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const KEY_SPEED = 70; // mm/s

export class Pad {
  /** `push(x, y, pressure, t)` is given each event: mm from the upper left corner, 0 … 1, s. */
  constructor(canvas, push, trailMs = TRAIL_MS) {
    Object.assign(this, { canvas, push, trailMs, tile: null, tileMm: 24, trail: [], pen: null, drawn: 0 });
    this.mmPerPx = Number(localStorage.getItem("mm-per-px")) || 25.4 / 96; // 96 to the inch, unless a card was held to the screen
    this.force = 0.5; // of what has no pressure
    this.keys = new Set();
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    const listen = (type, how) => canvas.addEventListener(type, how);
    listen("pointerdown", (e) => this.down(e));
    listen("onpointerrawupdate" in canvas ? "pointerrawupdate" : "pointermove", (e) => this.moved(e));
    for (const type of ["pointerup", "pointercancel", "lostpointercapture"]) listen(type, (e) => this.up(e));
    listen("contextmenu", (e) => e.preventDefault());
    listen("keydown", (e) => this.key(e, true));
    listen("keyup", (e) => this.key(e, false));
    listen("blur", () => this.releaseKeys());
    new ResizeObserver(() => this.resize()).observe(canvas);
  }

  setMmPerPx(value) {
    this.mmPerPx = value;
    localStorage.setItem("mm-per-px", value);
    this.draw();
  }

  resize() {
    const ratio = devicePixelRatio;
    this.canvas.width = Math.round(this.canvas.clientWidth * ratio);
    this.canvas.height = Math.round(this.canvas.clientHeight * ratio);
    this.draw();
  }

  /** A mouse and most fingers have no pressure: browsers say 0.5, or 0, while they are down. A pen's 0 is the lightest touch. */
  pressure(e) {
    return e.pointerType === "pen" ? Math.max(e.pressure, LIGHTEST) : this.force;
  }

  inside(x, y) {
    return x >= 0 && y >= 0 && x <= this.canvas.clientWidth && y <= this.canvas.clientHeight;
  }

  down(e) {
    if (this.pen !== null || (e.pointerType === "mouse" && e.button !== 0)) return;
    this.ghost = null;
    this.pen = e.pointerId;
    this.canvas.setPointerCapture(e.pointerId);
    this.origin = this.canvas.getBoundingClientRect();
    this.touching = false;
    this.take(e);
    this.dispatch?.(e);
  }

  moved(e) {
    if (e.pointerId !== this.pen) return;
    const merged = e.getCoalescedEvents?.() ?? [];
    for (const one of merged.length ? merged : [e]) this.take(one);
  }

  /** The texture ends where its area does: there the pen counts as lifted. */
  take(e) {
    const x = e.clientX - this.origin.left, y = e.clientY - this.origin.top;
    const touches = this.inside(x, y);
    if (touches || this.touching) this.event(x, y, touches ? this.pressure(e) : 0, e.timeStamp);
    this.touching = touches;
  }

  up(e) {
    if (e.pointerId !== this.pen) return;
    this.pen = null;
    if (this.touching) this.event(e.clientX - this.origin.left, e.clientY - this.origin.top, 0, e.timeStamp);
    this.touching = false;
  }

  event(x, y, pressure, ms) {
    this.push(x * this.mmPerPx, y * this.mmPerPx, pressure, ms / 1000);
    this.trail.push({ x, y, pressure, ms });
    if (this.trail.length > 400) this.trail.shift();
    this.wake();
  }

  /** Stroke by itself, in an S over the surface, until a hand takes over. */
  play(seconds = 2.6) {
    const begin = performance.now(), mine = (this.ghost = {});
    const { clientWidth: w, clientHeight: h } = this.canvas;
    const reach = Math.min(w, 620) / 2;
    const step = () => {
      if (this.ghost !== mine) return;
      const t = (performance.now() - begin) / 1000 / seconds, share = Math.min(1, t);
      const x = w / 2 + reach * 0.8 * Math.sin(2 * Math.PI * (share - 0.25) * 1.2), y = h * (0.35 + 0.3 * share);
      const ends = t >= 1;
      this.event(x, y, ends ? 0 : 0.35 + 0.3 * Math.sin(Math.PI * share), performance.now());
      if (ends) this.ghost = null;
      else setTimeout(step, STEP_MS);
    };
    step();
  }

  key(e, down) {
    if (!(e.key in KEYS) && e.key !== " " && e.key !== "Shift") return;
    if (e.key !== "Shift") e.preventDefault();
    if (e.repeat) return;
    this.keys[down ? "add" : "delete"](e.key);
    const strokes = [...this.keys].some((key) => key in KEYS);
    if (strokes && !this.walking) this.walk();
    if (down && e.key in KEYS) this.dispatch?.(e);
  }

  releaseKeys() {
    this.keys.clear();
  }

  /** A stroke by keys: a pen that moves at one speed while arrows are held, and turns back at an edge. */
  walk() {
    this.ghost = null;
    const { clientWidth: w, clientHeight: h } = this.canvas;
    let { u, v } = this.walker ?? { u: w / 2, v: h / 2 }, before = performance.now(), vx = 0, vy = 0, x, y;
    const folded = (at, size) => size - Math.abs((((at % (2 * size)) + 2 * size) % (2 * size)) - size);
    this.walking = setInterval(() => {
      const now = performance.now(), s = (now - before) / 1000;
      before = now;
      const held = [...this.keys].filter((key) => key in KEYS).map((key) => KEYS[key]);
      if (!held.length) {
        clearInterval(this.walking);
        this.walking = null;
        this.event(x, y, 0, now);
        return;
      }
      const speed = (this.keys.has("Shift") ? 2.5 : 1) * (KEY_SPEED / this.mmPerPx);
      const wanted = held.reduce(([a, b], [c, d]) => [a + c, b + d], [0, 0]);
      vx += 0.2 * (wanted[0] * speed - vx);
      vy += 0.2 * (wanted[1] * speed - vy);
      u += s * vx;
      v += s * vy;
      this.walker = { u, v };
      [x, y] = [folded(u, w), folded(v, h)];
      this.event(x, y, this.keys.has(" ") ? Math.min(1, this.force + 0.3) : this.force, now);
    }, STEP_MS);
  }

  setTile(tile, mm) {
    Object.assign(this, { tile, tileMm: mm });
    this.draw();
  }

  wake() {
    if (this.drawing) return;
    this.drawing = requestAnimationFrame(() => {
      this.drawing = null;
      this.draw();
      const now = performance.now();
      this.trail = this.trail.filter((one) => now - one.ms < this.trailMs);
      if (this.trail.length) this.wake();
    });
  }

  draw() {
    const { canvas, trail } = this, g = canvas.getContext("2d"), ratio = devicePixelRatio, now = performance.now();
    g.setTransform(1, 0, 0, 1, 0, 0);
    g.clearRect(0, 0, canvas.width, canvas.height);
    if (this.tile) {
      const pattern = g.createPattern(this.tile, "repeat"), scale = ((CLOSER * this.tileMm) / this.mmPerPx / this.tile.width) * ratio;
      pattern.setTransform(new DOMMatrix([scale, 0, 0, scale, 0, 0]));
      g.fillStyle = pattern;
      g.fillRect(0, 0, canvas.width, canvas.height);
    }
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.lineCap = "round";
    for (let i = 1; i < trail.length; i++) {
      const [a, b] = [trail[i - 1], trail[i]];
      if (!a.pressure || !b.pressure) continue;
      const age = Math.min(1, (now - b.ms) / this.trailMs);
      g.strokeStyle = `rgb(255 255 255 / ${0.55 * (1 - age) ** 2})`;
      g.lineWidth = 2 + 10 * b.pressure * (1 - age);
      g.beginPath();
      g.moveTo(a.x, a.y);
      g.lineTo(b.x, b.y);
      g.stroke();
    }
    const last = trail.at(-1);
    if (!last?.pressure || now - last.ms > this.trailMs) return;
    const radius = 14 + 34 * last.pressure, glow = g.createRadialGradient(last.x, last.y, 0, last.x, last.y, radius);
    glow.addColorStop(0, "rgb(255 255 255 / 0.85)");
    glow.addColorStop(0.25, "rgb(255 255 255 / 0.35)");
    glow.addColorStop(1, "rgb(255 255 255 / 0)");
    g.fillStyle = glow;
    g.fillRect(last.x - radius, last.y - radius, 2 * radius, 2 * radius);
  }
}
