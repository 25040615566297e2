// Volume, calibration of force and of the screen, the actuator, and how late it all is.

const CARD_MM = 53.98; // the short side of a bank card, ISO/IEC 7810 ID-1
const SIZES_PX = [120, 640]; // that it may have on a screen
const TALLEST = 0.8; // of the window, for a bar that stands upright, so that all of it is seen
const NARROW_PX = 480; // on what is narrower the bar stands upright: there is more room
const PAPER = { newtons: 0.13, steepness: 3.32 }; // Eq. 12
const GRAM_N = 0.00980665;
const OTHERS = "others"; // asks for their names
const STEADY = 0.03, STEADY_MS = 300; // pressure within which, and for how long, a pen is held still on the scale

// Of the parts that a study's page shows too, which speaks other languages. It is JSON, and read by the study as such.
export const WORDS = {
  "settings": "Settings",
  "close": "Close",
  "volume": "Volume",
  "off": "off",
  "force": "Force",
  "force_how": "Lay the tablet on a kitchen scale, press the pen here, and write what the scale shows.",
  "press_here": "Press here",
  "grams_label": "grams on the scale",
  "grams": "grams",
  "add": "Add",
  "paper": "Paper's",
  "curve": "{low} N at the lightest touch to {high} N at full pressure",
  "curve_weighed": "{curve}, from {n} weighings",
  "equation": "F = {a} N · exp({b} · pressure), Eq. 12 of the paper",
  "too_few": "{n} weighed: three or more, light to firm, are needed",
  "no_pressure": "A finger or a mouse has no pressure: the slider on the surface sets its force.",
  "hold_still": "Hold the pen still for half a second, then lift it.",
  "size": "Size",
  "size_how": "Hold the short side of a bank card to the bar, and make the bar as long.",
  "bar_length": "length of the bar"
};

/** Return text with values in the place of `{names}`. */
export const filled = (text, values) => text.replace(/\{(\w+)\}/g, (name, key) => values[key] ?? name);

/** Return a number as the page's language writes it. */
export const written = (value, digits = 0) =>
  new Intl.NumberFormat(document.documentElement.lang || undefined, { minimumFractionDigits: digits, maximumFractionDigits: digits }).format(value);

/** Return the median pressure of the longest stretch that a pen was held still, of [ms, pressure] in their order; null where it was not. */
export function steady(samples) {
  let best = null;
  for (let from = 0, to = 0; from < samples.length; from++) {
    let low = Infinity, high = -Infinity;
    for (to = from; to < samples.length; to++) {
      low = Math.min(low, samples[to][1]);
      high = Math.max(high, samples[to][1]);
      if (high - low > STEADY) break;
    }
    // What was said last holds until the next is said.
    const lasted = (to < samples.length ? samples[to][0] : samples.at(-1)[0]) - samples[from][0];
    if (lasted >= STEADY_MS && lasted > (best?.lasted ?? 0)) best = { lasted, from, to };
  }
  if (!best) return null;
  const held = samples.slice(best.from, best.to).map(([, pressure]) => pressure).sort((a, b) => a - b);
  return held[held.length >> 1];
}

const FIGURES = { resonance_hz: [0, 1e4], damping: [0, 100], gain: [-1e6, 1e6], lowest_hz: [0, 1e4], limit: [0, 1e6] };

/** Return an actuator of a profile's text, or throw a line for people. */
export function actuatorOf(text) {
  let profile;
  try {
    profile = JSON.parse(text);
  } catch {
    throw new Error("this is no JSON, and no actuator's profile");
  }
  if (profile?.format !== "foten-actuator") throw new Error("this is no actuator's profile");
  if (profile.version !== 1) throw new Error(`its version is ${profile.version}, expected 1`);
  const figures = { resonance_hz: 0, damping: 0.25, gain: 1, lowest_hz: 20, limit: 0, ...profile };
  for (const [name, [low, high]] of Object.entries(FIGURES))
    if (typeof figures[name] !== "number" || !(figures[name] >= low && figures[name] <= high)) throw new Error(`${name} is ${figures[name]}, expected ${low} to ${high}`);
  if (figures.gain === 0) throw new Error("gain is 0, expected m/s² for one unit of drive");
  const unit = typeof profile.unit === "string" ? profile.unit : "V";
  return {
    name: String(profile.name || ""), unit, resonanceHz: figures.resonance_hz, damping: figures.damping, gain: figures.gain, lowestHz: figures.lowest_hz, limit: figures.limit,
    fullScale: unit === "full scale" ? 1 : figures.limit || 1,
  };
}

/** Return a and b of force = a exp(b pressure) nearest to pairs [pressure, N] in the mean square of force; null where they are too few. */
export function fitted(pairs) {
  const used = pairs.filter(([p, f]) => p > 0 && p <= 1 && f > 0);
  const span = Math.max(...used.map(([p]) => p)) - Math.min(...used.map(([p]) => p));
  if (used.length < 3 || !(span >= 0.1)) return null;
  const mean = (of) => used.reduce((sum, one) => sum + of(one), 0) / used.length;
  const p0 = mean(([p]) => p), l0 = mean(([, f]) => Math.log(f));
  let b = mean(([p, f]) => (p - p0) * (Math.log(f) - l0)) / mean(([p]) => (p - p0) ** 2), c = l0 - b * p0, damping = 1e-3;
  const missed = (b, c) => used.reduce((sum, [p, f]) => sum + (Math.exp(b * p + c) - f) ** 2, 0);
  for (let i = 0; i < 200; i++) { // Levenberg and Marquardt, from the line through the logarithms
    let bb = 0, bc = 0, cc = 0, gb = 0, gc = 0;
    for (const [p, f] of used) {
      const e = Math.exp(b * p + c), off = e - f;
      bb += e * p * e * p;
      bc += e * p * e;
      cc += e * e;
      gb -= e * p * off;
      gc -= e * off;
    }
    const [x, y] = [bb * (1 + damping), cc * (1 + damping)], determinant = x * y - bc * bc;
    const db = (gb * y - gc * bc) / determinant, dc = (x * gc - bc * gb) / determinant;
    if (missed(b + db, c + dc) <= missed(b, c)) {
      [b, c, damping] = [b + db, c + dc, damping / 10];
      if (Math.abs(db) + Math.abs(dc) < 1e-12) break;
    } else damping *= 10;
    if (damping > 1e11) break;
  }
  return { newtons: Math.exp(c), steepness: b };
}

export class Settings {
  constructor(dialog, sound, pad, words = WORDS) {
    Object.assign(this, { dialog, sound, pad, words });
    this.calibration = JSON.parse(localStorage.getItem("calibration") ?? "null") ?? PAPER;
    this.actuator = JSON.parse(localStorage.getItem("actuator") ?? "null");
    this.weighings = [];
    dialog.innerHTML = `
      <form method="dialog"><button class="icon close"><svg viewBox="0 0 24 24" aria-hidden="true"><path d="m6 6 12 12M18 6 6 18"/></svg></button></form>
      <h2 data-words="settings"></h2>
      <div class="row" id="paths" hidden><label for="path">Rendered</label><select id="path"><option value="">in this page</option><option value="stream">by the server, played here</option><option value="device">by the server, played there</option></select></div>
      <div class="row" id="output" data-part="output"><label for="sink">Output</label><select id="sink"></select><label for="channel">Channel</label><select id="channel"></select></div>
      <div class="row"><label for="volume" data-words="volume"></label><input id="volume" type="range" min="-40" max="12" step="1"><output id="volume-db"></output></div>
      <h3 data-words="force"></h3>
      <p data-words="force_how"></p>
      <div class="row"><button id="weigh" class="plain" type="button" data-words="press_here"></button><output id="pressure"></output>
        <input id="grams" type="number" min="1" max="3000" step="1"><button id="add" class="plain" type="button" data-words="add"></button><button id="paper" class="plain" type="button" data-words="paper"></button></div>
      <p><output id="curve"></output></p>
      <h3 data-words="size"></h3>
      <p data-words="size_how"></p>
      <div class="card"><div id="card"></div></div>
      <input id="size" type="range" step="1">
      <section data-part="actuator"><h3>Actuator</h3>
      <div class="row"><button id="profile-open" class="plain" type="button">Open a profile</button><button id="profile-none" class="plain" type="button" hidden>None</button><input id="profile" type="file" accept=".json" hidden><output id="actuator"></output></div>
      <div class="row" id="drive" hidden><label for="full-scale">Full scale of the output is</label><input id="full-scale" type="number" min="0" step="any"><span id="drive-unit"></span></div>
      </section>
      <section data-part="delay"><h3>Delay</h3>
      <table aria-label="Delay"><tr><td></td><th>median</th><th>99 %</th></tr>
        <tr><th>pen to graph</th><td id="own50"></td><td id="own99"></td></tr><tr><th>pen to sound</th><td id="all50"></td><td id="all99"></td></tr></table>
      <p><output id="buffers"></output> <output id="quanta"></output></p>
      <div class="row"><label for="buffer">Buffer</label><select id="buffer"><option value="quick">the shortest that the device has</option><option value="steady">longer, if it crackles</option></select></div></section>`;
    const $ = (id) => dialog.querySelector(`#${id}`);
    this.$ = $;
    for (const element of dialog.querySelectorAll("[data-words]")) element.textContent = words[element.dataset.words];
    dialog.querySelector(".close").ariaLabel = words.close;
    Object.assign($("grams"), { ariaLabel: words.grams_label, placeholder: words.grams });
    $("size").ariaLabel = words.bar_length;
    $("pressure").value = written(0, 2);
    $("volume").value = Number(localStorage.getItem("volume") ?? sound.volumeDb);
    $("volume").addEventListener("input", () => this.setVolume());
    this.setVolume();
    for (const type of ["pointerdown", "pointermove", "pointerup", "pointercancel"]) $("weigh").addEventListener(type, (e) => this.weigh(e));
    $("add").addEventListener("click", () => this.add());
    $("paper").addEventListener("click", () => this.setCalibration(PAPER, (this.weighings = [])));
    $("size").addEventListener("input", () => this.setSize());
    $("profile").addEventListener("change", (e) => this.open(e.target.files[0]));
    $("profile-open").addEventListener("click", () => $("profile").click());
    $("profile-none").addEventListener("click", () => this.setActuator(null));
    $("full-scale").addEventListener("input", () => Number($("full-scale").value) > 0 && this.setActuator({ ...this.actuator, fullScale: Number($("full-scale").value) }));
    $("path").addEventListener("change", () => this.choose());
    $("sink").addEventListener("change", () => this.setOutput());
    $("channel").addEventListener("change", () => this.setOutput());
    sound.addEventListener("path", ({ detail }) => ($("path").value = detail));
    $("buffer").value = localStorage.getItem("buffer") ?? "quick";
    $("buffer").addEventListener("change", () => {
      localStorage.setItem("buffer", $("buffer").value);
      location.reload(); // a context keeps its buffer
    });
    addEventListener("resize", () => dialog.open && this.showSize());
    const [sink, channel] = [localStorage.getItem("sink") ?? "", localStorage.getItem("channel") || null];
    if (sink || channel) sound.route?.(sink, channel && Number(channel));
    this.curve();
    this.setActuator(this.actuator, false);
  }

  /** Offer the outputs that the browser tells of: their names are told only to pages that may listen, which Others asks for. */
  async listOutputs() {
    if (!this.sound.route) return; // a page that plays otherwise
    const { $ } = this, kept = localStorage.getItem("sink") ?? "", channel = localStorage.getItem("channel") ?? "";
    const known = (await navigator.mediaDevices?.enumerateDevices()) ?? [];
    const named = known.filter((one) => one.kind === "audiooutput" && one.label && one.deviceId !== "default");
    const canChoose = "setSinkId" in AudioContext.prototype && navigator.mediaDevices;
    const others = canChoose && !named.length ? [new Option("Others…", OTHERS)] : [];
    $("sink").replaceChildren(new Option("the usual one", ""), ...(canChoose ? named : []).map((one) => new Option(one.label, one.deviceId)), ...others);
    $("sink").value = named.some((one) => one.deviceId === kept) ? kept : "";
    const numbers = Array.from({ length: this.sound.channels }, (_, i) => new Option(String(i + 1), String(i)));
    $("channel").replaceChildren(new Option("all", ""), ...numbers);
    $("channel").value = Number(channel) < this.sound.channels ? channel : "";
  }

  async setOutput() {
    const { $ } = this;
    try {
      if ($("sink").value === OTHERS) {
        const stream = await navigator.mediaDevices.getUserMedia({ audio: true });
        stream.getTracks().forEach((track) => track.stop());
        return await this.listOutputs();
      }
      await this.sound.route($("sink").value, this.channel);
      localStorage.setItem("sink", $("sink").value);
      localStorage.setItem("channel", $("channel").value);
    } catch (error) {
      this.sound.emit("failed", `this output does not play: ${error.message}`);
    }
    await this.listOutputs(); // another output has other channels
  }

  /** Channel that is chosen, from 0; null for all. */
  get channel() {
    return this.$("channel").value === "" ? null : Number(this.$("channel").value);
  }

  /** Offer the server's sound, where there is one. */
  offer(server) {
    this.$("paths").hidden = !server;
  }

  /** Have all rendered on another path, and show that. */
  async render(path) {
    this.$("path").value = path;
    await this.choose();
  }

  async choose() {
    const path = this.$("path");
    try {
      await this.sound.start();
      await this.sound.from(path.value);
    } catch (error) {
      path.value = "";
      this.sound.emit("failed", error.message);
    }
  }

  /** Tell a sound that has begun what was chosen. */
  apply() {
    this.sound.calibrate(this.calibration);
    if (this.actuator) this.setActuator(this.actuator);
  }

  show() {
    this.dialog.showModal();
    this.showSize();
    this.listOutputs();
    const tick = () => {
      if (!this.dialog.open) return;
      this.delay();
      setTimeout(tick, 300);
    };
    tick();
  }

  setVolume() {
    const db = Number(this.$("volume").value);
    localStorage.setItem("volume", db);
    this.$("volume-db").value = db <= -40 ? this.words.off : `${written(db)} dB`;
    this.sound.setVolume(db);
  }

  /** A pen that leaves the scale presses less and less: what counts is where it was held still. */
  weigh(e) {
    if (e.pointerType !== "pen") {
      this.$("curve").value = this.words.no_pressure;
      return;
    }
    if (e.type === "pointerdown") {
      this.$("weigh").setPointerCapture(e.pointerId);
      this.pressed = [];
    }
    if (!this.pressed) return;
    const ends = e.type === "pointerup" || e.type === "pointercancel";
    this.pressed.push([e.timeStamp, ends ? this.pressed.at(-1)?.[1] ?? 0 : e.pressure]);
    if (!ends) return void (this.$("pressure").value = written(e.pressure, 2));
    this.pressure = steady(this.pressed);
    this.pressed = null;
    this.$("pressure").value = this.pressure === null ? "–" : written(this.pressure, 2);
    if (this.pressure === null) this.$("curve").value = this.words.hold_still;
  }

  add() {
    const grams = Number(this.$("grams").value);
    if (!(grams > 0) || !this.pressure) return;
    this.weighings.push([this.pressure, grams * GRAM_N]);
    this.$("grams").value = "";
    const calibration = fitted(this.weighings);
    if (calibration) this.setCalibration(calibration);
    else this.$("curve").value = filled(this.words.too_few, { n: this.weighings.length });
  }

  setCalibration(calibration) {
    this.calibration = calibration;
    localStorage.setItem("calibration", JSON.stringify(calibration));
    this.sound.calibrate(calibration);
    this.curve();
  }

  curve() {
    const { words, weighings: { length: n }, calibration: { newtons: a, steepness: b } } = this;
    const curve = filled(words.curve, { low: written(a, 2), high: written(a * Math.exp(b), 1) });
    this.$("curve").value = n ? filled(words.curve_weighed, { curve, n }) : curve;
    this.$("curve").title = filled(words.equation, { a: written(a, 2), b: written(b, 2) });
  }

  /** The bar has all lengths that the slider has: what is cut off would be measured wrong without a word. */
  showSize() {
    const size = this.$("size"), card = this.$("card"), width = card.parentElement.clientWidth;
    this.upright = width < NARROW_PX;
    card.classList.toggle("upright", this.upright);
    [size.min, size.max] = [SIZES_PX[0], Math.floor(Math.min(SIZES_PX[1], this.upright ? TALLEST * innerHeight : width))];
    size.value = Math.round(CARD_MM / this.pad.mmPerPx);
    this.drawSize();
  }

  drawSize() {
    const length = `${this.$("size").value}px`;
    [this.$("card").style.width, this.$("card").style.height] = this.upright ? ["", length] : [length, ""];
  }

  setSize() {
    this.drawSize();
    this.pad.setMmPerPx(CARD_MM / Number(this.$("size").value));
  }

  async open(file) {
    if (!file) return;
    try {
      const actuator = actuatorOf(await file.text());
      this.setActuator({ ...actuator, name: actuator.name || file.name });
    } catch (error) {
      this.$("actuator").value = `${file.name}: ${error.message}`;
    }
    this.$("profile").value = "";
  }

  setActuator(actuator, tell = true) {
    this.actuator = actuator;
    const { $ } = this;
    $("actuator").value = actuator ? `${actuator.name}: ${actuator.resonanceHz} Hz` : "none: acceleration is played as it is";
    $("profile-none").hidden = !actuator;
    $("drive").hidden = !actuator || actuator.unit === "full scale";
    $("drive-unit").textContent = actuator?.unit ?? "";
    if (actuator && Number($("full-scale").value) !== actuator.fullScale) $("full-scale").value = actuator.fullScale;
    if (!tell) return;
    localStorage.setItem("actuator", JSON.stringify(actuator));
    this.sound.actuate(actuator);
    this.sound.emit("unit", actuator?.unit);
  }

  delay() {
    const { n, ownP50, ownP99, totalP50, totalP99, buffer, device, rate } = this.sound.latency;
    const ms = (value) => (value === null || value === undefined ? "–" : `${value.toFixed(1)} ms`);
    for (const [id, value] of Object.entries({ own50: ownP50, own99: ownP99, all50: totalP50, all99: totalP99 })) this.$(id).textContent = ms(value);
    const state = this.sound.server?.state, lost = this.sound.context?.playbackStats?.underrunEvents; // where a browser counts them
    this.$("quanta").value = this.took && !state ? `128 samples take ${this.took[0].toFixed(2)} ms, 99 % ${this.took[1].toFixed(2)} ms, of the ${(128e3 / (rate ?? 48000)).toFixed(1)} ms that they play.${lost === undefined ? "" : ` ${lost} under-runs.`}` : "";
    if (state) {
      this.$("buffers").value = `at the server: blocks of ${state.block_ms.toFixed(0)} ms in ${ms(state.block_p50_ms)}, 99 % in ${ms(state.block_p99_ms)}; ${state.n_missed} late, ${state.n_underruns} under-runs`;
      return;
    }
    this.$("buffers").value = n
      ? `${n} events; buffer ${ms(buffer)}, device ${ms(device)}, ${rate / 1000} kHz. The texture's own low-pass of the hand adds 11 ms.`
      : "Stroke the surface to measure it.";
  }
}
