// A surface of one's own: the sound of a pen on it, and the pen's events, joined by taps; the server learns a texture from them.
import { Coverage } from "./coverage.js";
import { Levels } from "./levels.js";
import { Pad } from "./pad.js";
import { save, wavOf } from "./stroke.js";

const TAPS = 3;
const TAP_S = 0.3, TAP_MM = 3; // at most, as the server has it
const KNOCK = 4; // times what was heard before
const HEARD_S = 0.35, EARLY_S = 0.2; // within which a knock has arrived after a touch, or before it where the pen is slow
const LEAST_S = 8; // of strokes
const LONGEST_S = 240;
const DRAWN_MS = 50, TRAIL_MS = 80;
const AN_RMS_OF_1_G = 9.80665; // m/s², of the usual calibrators
const FILTERS = { echoCancellation: "echo cancellation", noiseSuppression: "noise suppression", autoGainControl: "automatic gain" };
const INSIDE = `
  <div id="sheet"><canvas id="surface" tabindex="0" role="img" aria-label="Lay the surface here, and stroke it with the pen."></canvas><p>Lay the surface here</p></div>
  <div id="guide">
    <form method="dialog"><button class="icon close" aria-label="Close"><svg viewBox="0 0 24 24" aria-hidden="true"><path d="m6 6 12 12M18 6 6 18"/></svg></button></form>
    <h2 id="step" aria-live="polite">Capture a surface</h2>
    <div id="taps" aria-hidden="true" hidden>${"<i></i>".repeat(TAPS)}</div>
    <div id="field" hidden><span class="up"><span>light</span><span>firm</span></span><canvas id="coverage" role="img" aria-label="Speeds and forces that were stroked"></canvas><span class="slow">slow</span><span>fast</span></div>
    <progress id="learning" max="1" value="0" aria-label="Progress of the training" hidden></progress>
    <div id="set-up">
      <label>Name <input id="called" class="plain" maxlength="60" value="My surface" autocomplete="off"></label>
      <label>Input <select id="inputs"></select></label>
      <details><summary>Sensitivity</summary>
        <p class="row"><label>sensor <input id="sensor" type="number" min="0" step="any"> mV per m/s²</label> <label>input <input id="full" type="number" min="0" step="any"> mV at full scale</label></p>
        <p class="row"><button id="calibrator" class="plain" type="button">On a calibrator of 1 g</button><output id="scale">Relative units without</output></p></details>
    </div>
    <div id="hears" role="meter" aria-label="Level of the input" aria-valuemin="-80" aria-valuemax="0"><i></i></div>
    <p id="trouble" role="status"></p>
    <div class="row"><button id="go" class="plain main" type="button">Begin</button><button id="keep" class="plain" type="button" hidden>Save sound and events</button></div>
  </div>`;

export class Capture {
  /** `calibration()` gives a and b of Eq. 12; `onTexture(listed, done)` is given a texture of the server's, once and when it is better. */
  constructor(dialog, { calibration, onTexture, canTrain }) {
    Object.assign(this, { dialog, calibration, onTexture, canTrain, step: "closed", fullScale: null });
    dialog.innerHTML = INSIDE;
    this.$ = (id) => dialog.querySelector(`#${id}`);
    this.pad = new Pad(this.$("surface"), (...event) => this.event(...event), TRAIL_MS);
    this.pad.dispatch = (e) => this.touched(e);
    this.coverage = new Coverage(this.$("coverage"));
    this.$("go").addEventListener("click", () => this.attempt(() => this.go()));
    this.$("keep").addEventListener("click", () => this.keep());
    this.$("inputs").addEventListener("change", () => this.attempt(() => this.listen(this.$("inputs").value)));
    this.$("calibrator").addEventListener("click", () => this.attempt(() => this.calibrate()));
    for (const id of ["sensor", "full"]) this.$(id).addEventListener("input", () => this.setScale(Number(this.$("full").value) / Number(this.$("sensor").value)));
    dialog.addEventListener("close", () => this.close());
  }

  async attempt(what) {
    try {
      await what();
    } catch (error) {
      this.fail(error.message);
    }
  }

  show() {
    this.dialog.showModal();
    this.enter("set-up");
    this.pad.mmPerPx = Number(localStorage.getItem("mm-per-px")) || this.pad.mmPerPx;
    const tick = () => {
      if (!this.dialog.open) return;
      this.draw();
      setTimeout(tick, DRAWN_MS);
    };
    tick();
    return this.attempt(() => this.listen());
  }

  enter(step) {
    this.step = step;
    this.dialog.dataset.step = step;
    const taps = step === "tap-in" || step === "tap-out";
    for (const [id, on] of Object.entries({ "set-up": step === "set-up", taps, field: step === "stroke", learning: step === "training", hears: step !== "training" && step !== "kept", keep: step === "failed" || step === "kept" }))
      this.$(id).hidden = !on;
    if (taps) this.knocks = 0;
    this.$("go").hidden = taps || step === "training" || step === "kept";
    this.$("go").textContent = { stroke: "Done", failed: "Again" }[step] ?? "Begin";
    this.$("step").textContent =
      { "set-up": "Capture a surface", "tap-in": "Tap three times", "tap-out": "Tap three times", training: "Learning", kept: "Captured", failed: "Not captured" }[step] ?? "Stroke";
    if (step !== "failed") this.trouble = "";
  }

  // The input

  async listen(deviceId) {
    this.unlisten();
    if (!navigator.mediaDevices) throw new Error("this browser gives no input to this page: open it over HTTPS, or at localhost");
    const off = Object.fromEntries(Object.keys(FILTERS).map((name) => [name, false]));
    let stream;
    try {
      stream = await navigator.mediaDevices.getUserMedia({ audio: { ...off, channelCount: 1, ...(deviceId && { deviceId: { exact: deviceId } }) } });
    } catch (error) {
      throw new Error(error.name === "NotAllowedError" ? "the page may not listen: allow the microphone for it" : error.name === "NotFoundError" ? "there is no input: plug the microphone in" : error.message);
    }
    this.stream = stream;
    const [track] = stream.getAudioTracks(), settings = track.getSettings();
    const on = Object.keys(FILTERS).filter((name) => settings[name] === true).map((name) => FILTERS[name]);
    if (on.length) {
      this.unlisten();
      throw new Error(`the browser does not turn off ${on.join(" and ")} of this input, which would alter the vibration: take another input or browser`);
    }
    this.input = track.label || "audio input";
    track.addEventListener("ended", () => this.fail("the input was unplugged"));
    this.context = new AudioContext(settings.sampleRate ? { sampleRate: settings.sampleRate } : {});
    await this.context.audioWorklet.addModule("input.js");
    const node = new AudioWorkletNode(this.context, "foten-input", { numberOfOutputs: 0, channelCount: 1, channelCountMode: "explicit" });
    node.port.onmessage = ({ data }) => (data.piece ? this.received(data.piece) : this.lost(data.missing));
    this.context.createMediaStreamSource(stream).connect(node);
    await this.context.resume();
    this.levels = new Levels(this.context.sampleRate);
    this.peaks = [];
    const inputs = (await navigator.mediaDevices.enumerateDevices()).filter((one) => one.kind === "audioinput");
    this.$("inputs").replaceChildren(...inputs.map((one, i) => new Option(one.label || `Input ${i + 1}`, one.deviceId, false, one.deviceId === settings.deviceId)));
  }

  unlisten() {
    for (const track of this.stream?.getTracks() ?? []) track.stop();
    this.context?.close();
    this.stream = this.context = this.levels = null;
  }

  received(piece) {
    if (!this.levels) return;
    this.levels.add(piece, this.pad.touching);
    this.peaks.push([performance.now() / 1000, this.levels.peak]);
    if (this.peaks.length > 200) this.peaks.shift();
    if (!this.pieces) return;
    this.pieces.push(piece);
    this.send("s", piece);
    if (this.pieces.length * piece.length > LONGEST_S * this.context.sampleRate) this.fail(`a capture has at most ${LONGEST_S / 60} minutes`);
  }

  lost(missing) {
    if (this.pieces) this.fail(`the browser lost ${missing} samples of the sound: close other pages, and try again`);
  }

  setScale(value) {
    this.fullScale = value > 0 && Number.isFinite(value) ? value : null;
    this.$("scale").value = this.fullScale ? `full scale is ${this.fullScale.toPrecision(3)} m/s²` : "Relative units without";
  }

  /** A shaker moves the sensor with an RMS of 1 g: a second of it says what full scale is. */
  async calibrate() {
    let squares = 0, n = 0;
    const add = this.levels.add.bind(this.levels);
    this.levels.add = (piece, down) => (add(piece, down), (squares += this.levels.rms ** 2), n++);
    await new Promise((resolve) => setTimeout(resolve, 1000));
    this.levels.add = add;
    const rms = Math.sqrt(squares / Math.max(1, n));
    this.setScale(rms > 1e-3 ? AN_RMS_OF_1_G / rms : NaN);
    if (!this.fullScale) this.$("scale").value = "Hardly anything is heard: is the calibrator on?";
  }

  // The steps

  async go() {
    if (this.step === "failed") {
      this.enter("set-up");
      if (!this.levels) await this.listen();
    } else if (this.step === "set-up") await this.begin();
    else if (this.step === "stroke") this.enter("tap-out");
  }

  async begin() {
    if (!this.levels) await this.listen(this.$("inputs").value);
    this.pieces = [];
    this.events = [];
    this.unsent = [];
    this.levels.clipped = this.levels.lost = 0;
    this.started = performance.now() / 1000;
    this.about = { name: this.$("called").value.trim() || "My surface", rate_hz: this.context.sampleRate, ...this.calibration(), input: this.input.slice(0, 100), ...(this.fullScale && { full_scale_m_s2: this.fullScale }) };
    this.coverage.start(true);
    this.enter("tap-in");
    if (this.canTrain()) await this.connect();
  }

  connect() {
    const socket = (this.socket = new WebSocket(new URL("capture", location.href.replace(/^http/, "ws"))));
    const { about } = this;
    socket.onmessage = ({ data }) => this.answered(JSON.parse(data), socket);
    socket.onclose = ({ reason }) => this.socket === socket && this.recording && this.fail(`the server is gone${reason ? `: ${reason}` : ""}`);
    return new Promise((resolve, reject) => {
      socket.onopen = () => {
        socket.send(JSON.stringify({ do: "begin", ...about }));
        for (const [kind, values] of this.unsent.splice(0)) this.send(kind, values);
        resolve();
      };
      socket.onerror = () => reject(new Error("the server cannot be reached"));
    });
  }

  get recording() {
    return Boolean(this.pieces);
  }

  send(kind, values) {
    const { socket } = this;
    if (!socket) return;
    if (socket.readyState !== WebSocket.OPEN) return void this.unsent.push([kind, values]);
    const bytes = new Uint8Array(1 + values.byteLength);
    bytes[0] = kind.charCodeAt(0);
    bytes.set(new Uint8Array(values.buffer, values.byteOffset, values.byteLength), 1);
    socket.send(bytes);
  }

  touched(e) {
    if (this.step === "set-up" || this.step === "tap-in") this.coverage.start(e.pointerType === "pen");
  }

  event(x, y, pressure, seconds) {
    if (!this.recording) return;
    const t = seconds - this.started, { newtons, steepness } = this.about;
    this.events.push([x, y, pressure, t]);
    this.send("e", Float64Array.of(x, y, pressure, t));
    if (this.step === "stroke") this.coverage.take(x, y, pressure && newtons * Math.exp(steepness * pressure), t);
    if (pressure && !this.touch) this.touch = { t, at: seconds, x, y, path: 0 };
    else if (this.touch) {
      this.touch.path += Math.hypot(x - this.touch.x, y - this.touch.y);
      [this.touch.x, this.touch.y] = [x, y];
      if (!pressure) this.lifted(t);
    }
  }

  lifted(t) {
    const { touch, step } = this;
    this.touch = null;
    if (step !== "tap-in" && step !== "tap-out") return;
    if (t - touch.t > TAP_S || touch.path > TAP_MM) return void (this.trouble = "A tap is short, and stays where it is.");
    setTimeout(() => this.step === step && this.tapped(touch), 1000 * Math.max(0, HEARD_S - (t - touch.t)));
  }

  tapped({ at }) {
    const before = this.peaks.filter(([when]) => when < at - EARLY_S && when > at - 1.2).map(([, peak]) => peak).sort((a, b) => a - b);
    const during = this.peaks.filter(([when]) => when >= at - EARLY_S).map(([, peak]) => peak);
    if (Math.max(...during) < KNOCK * Math.max(before[before.length >> 1] ?? 0, 1e-4)) return void (this.trouble = "That was not heard: tap harder, or choose another input.");
    this.trouble = "";
    if (++this.knocks < TAPS) return;
    if (this.step === "tap-in") this.enter("stroke");
    else this.finish();
  }

  finish() {
    this.pieces.ended = true;
    this.taken = { pieces: this.pieces, events: this.events, rate: this.context.sampleRate };
    this.pieces = null;
    this.unlisten();
    if (!this.socket) {
      this.enter("kept");
      this.trouble = "This page has no server to learn from it: save it, and run foten import sound.wav --pen pen.csv.";
      return;
    }
    this.enter("training");
    this.socket.send(JSON.stringify({ do: "train" }));
  }

  answered(said, socket) {
    if (socket !== this.socket) return;
    if (said.refused) return this.fail(said.refused);
    if (said.share !== undefined) this.$("learning").value = said.share;
    if (said.stage) this.trouble = `${said.stage[0].toUpperCase()}${said.stage.slice(1)}`;
    if (said.joined) this.joined = said.joined;
    if (said.notes) this.notes = said.notes;
    if (said.playable) this.onTexture(said.playable, false);
    if (said.done) {
      this.socket = null;
      socket.close();
      this.onTexture(said.done, true);
    }
    if (said.playable && this.dialog.open) this.dialog.close();
  }

  fail(why) {
    if (this.pieces) this.taken = { pieces: this.pieces, events: this.events, rate: this.context?.sampleRate ?? 48000 };
    this.pieces = null;
    this.unlisten();
    const { socket } = this;
    this.socket = null;
    socket?.close();
    this.enter("failed");
    this.$("keep").hidden = !this.taken?.pieces.length;
    this.trouble = `${why[0].toUpperCase()}${why.slice(1)}`;
  }

  /** What was captured, as the files that `foten import sound.wav --pen pen.csv` reads. */
  keep() {
    const { pieces, events, rate } = this.taken, samples = new Float32Array(pieces.reduce((sum, one) => sum + one.length, 0));
    let at = 0;
    for (const piece of pieces) {
      samples.set(piece, at);
      at += piece.length;
    }
    save(wavOf(samples, rate), "sound.wav");
    const rows = events.map(([x, y, pressure, t]) => [t, x, y, pressure].map((value) => value.toFixed(6)).join(","));
    save(new Blob([["t [s],x [mm],y [mm],pressure", ...rows, ""].join("\n")], { type: "text/csv" }), "pen.csv");
  }

  close() {
    if (this.recording) {
      this.socket?.close();
      this.socket = null;
    }
    this.pieces = null;
    this.unlisten();
  }

  draw() {
    const { levels, step } = this;
    if (levels) {
      const db = Math.max(-80, 20 * Math.log10(Math.max(levels.rms, 1e-9)));
      this.shown = Math.max(db, (this.shown ?? -80) - 4);
      this.$("hears").setAttribute("aria-valuenow", Math.round(this.shown));
      this.$("hears").firstElementChild.style.transform = `scaleX(${1 + this.shown / 80})`;
    }
    if (step === "tap-in" || step === "tap-out") [...this.$("taps").children].forEach((dot, i) => (dot.className = i < this.knocks ? "on" : ""));
    if (step === "stroke") {
      this.coverage.draw();
      if (this.coverage.done >= 1) this.enter("tap-out");
      else {
        const { advice } = this.coverage;
        if (this.$("step").textContent !== advice && performance.now() - (this.advised ?? 0) > 700) {
          this.$("step").textContent = advice;
          this.advised = performance.now();
        }
        this.$("go").disabled = this.coverage.stroked < LEAST_S;
      }
    } else this.$("go").disabled = false;
    const text = this.trouble || (step === "set-up" || step === "stroke" ? levels?.trouble : "") || "";
    if (this.$("trouble").textContent !== text) this.$("trouble").textContent = text;
  }
}
