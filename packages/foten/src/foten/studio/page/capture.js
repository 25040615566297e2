// A surface of one's own: the sound of a pen on it, and the pen's events, joined by taps; the server learns a texture from them.
import { CaptureSession } from "./capture_session.js";
import { Coverage } from "./coverage.js";
import { Levels } from "./levels.js";
import { Pad } from "./pad.js";

const TAPS = 3;
const TAP_S = 0.3, TAP_MM = 3; // at most, as the server has it
const KNOCK = 4; // times what was heard before
const HEARD_S = 0.35, EARLY_S = 0.2; // within which a knock has arrived after a touch, or before it where the pen is slow
const MIN_STROKES_S = 8; // of strokes
const MAX_S = 240;
const DRAWN_MS = 50, TRAIL_MS = 80;
const AN_RMS_OF_1_G = 9.80665; // m/s², of the usual calibrators
const FULL_SCALES = [1e-3, 1e5]; // m/s², as the server has it
const NAMELESS = /^(default|communications)?$/i; // the label of whatever input the system takes: tomorrow that may be another
const FILTERS = { echoCancellation: "echo cancellation", noiseSuppression: "noise suppression", autoGainControl: "automatic gain" };
const INSIDE = `
  <div id="sheet"><canvas id="surface" tabindex="0" role="img" aria-label="Lay the surface here, and stroke it with the pen."></canvas>
    <figure id="how"><svg viewBox="0 0 240 150" role="img" aria-label="A pen with a small microphone fixed to it strokes a surface that lies on the tablet; the microphone's cable goes to this device.">
      <path class="tablet" d="M22 128h196a8 8 0 0 0 0-16H22a8 8 0 0 0 0 16z"/><path class="cloth" d="M52 112c10-5 14 3 24 0s14-6 24 0 14 4 24-1 14-3 24 1 14-4 22 0v-7c-8-4-12 3-22 0s-14-5-24 0-14 4-24 1-14-5-24 0-14 3-24-1z"/>
      <path class="pen" d="m117 109 8-19 50-72a7 7 0 0 1 12 8l-51 72z"/><circle class="mic" cx="140" cy="73" r="8"/><path class="cable" d="M132 71C104 62 96 34 70 36S42 66 22 60"/>
      <path class="sound" d="M150 88a24 24 0 0 0 8-18M157 96a36 36 0 0 0 13-26"/></svg>
      <figcaption>Fix a contact microphone to the pen, and lay the surface here</figcaption></figure></div>
  <div id="guide">
    <form method="dialog"><button class="icon close" aria-label="Close"><svg viewBox="0 0 24 24" aria-hidden="true"><path d="m6 6 12 12M18 6 6 18"/></svg></button></form>
    <h2 id="step" aria-live="polite">Capture a surface</h2>
    <div id="taps" aria-hidden="true" hidden>${"<i></i>".repeat(TAPS)}</div>
    <div id="field" hidden><span class="up"><span>light</span><span>firm</span></span><canvas id="coverage" role="img" aria-label="Speeds and forces that were stroked"></canvas><span class="slow">slow</span><span>fast</span></div>
    <progress id="learning" max="1" value="0" aria-label="Progress of the training" hidden></progress>
    <div id="set-up">
      <label>Name <input id="called" class="plain" maxlength="60" value="My surface" autocomplete="off"></label>
      <label>Input <select id="inputs"></select></label>
      <details><summary id="sensitivity">Sensitivity</summary>
        <p class="row"><label>Sensor, mV per m/s² <input id="sensor" type="number" min="0" step="any"></label> <label>Input, mV at full scale <input id="full" type="number" min="0" step="any"></label></p>
        <p class="row"><button id="calibrator" class="plain" type="button">On a calibrator of 1 g</button><button id="relative" class="plain" type="button" hidden>Forget</button><output id="scale"></output></p></details>
    </div>
    <div id="hears" role="meter" aria-label="Level of the input" aria-valuemin="-80" aria-valuemax="0"><i></i></div>
    <p id="trouble" role="status"></p>
    <div class="row"><button id="go" class="plain main" type="button">Begin</button><button id="keep" class="plain" type="button" hidden>Save sound and events</button></div>
    <div id="notes" hidden></div>
  </div>`;

const sentence = (text) => (text ? `${text[0].toUpperCase()}${text.slice(1)}` : "");

/** The dialog: it shows the newest capture; one that it shows no more goes on learning, and says what becomes of it. */
export class Capture {
  /**
   * `calibration()` gives a and b of Eq. 12; `onTexture(listed, done)` is given a texture of the server's, once and when it is
   * better; `say(text)` why a capture that is not shown any more failed.
   */
  constructor(dialog, { calibration, onTexture, canTrain, say }) {
    Object.assign(this, { dialog, calibration, onTexture, canTrain, say, step: "closed", fullScale: null, current: null, unsaid: [] });
    dialog.innerHTML = INSIDE;
    this.$ = (id) => dialog.querySelector(`#${id}`);
    this.pad = new Pad(this.$("surface"), (...event) => this.event(...event), TRAIL_MS);
    this.pad.dispatch = (e) => this.touched(e);
    this.coverage = new Coverage(this.$("coverage"));
    this.$("go").addEventListener("click", () => this.attempt(() => this.go()));
    this.$("keep").addEventListener("click", () => this.keep());
    this.$("inputs").addEventListener("change", () => this.attempt(() => this.listen(this.$("inputs").value)));
    this.$("calibrator").addEventListener("click", () => this.attempt(() => this.calibrate()));
    this.$("relative").addEventListener("click", () => this.setScale(null, ["", ""]));
    for (const id of ["sensor", "full"]) this.$(id).addEventListener("input", () => this.typed());
    dialog.addEventListener("close", () => dialog.open || this.leave()); // the event comes later, and the dialog may be open again
  }

  async attempt(what) {
    try {
      await what();
    } catch (error) {
      this.fail(error.message);
    }
  }

  show() {
    this.leave();
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
    const taps = step === "tap-in" || step === "tap-out", learning = step === "training", kept = step === "kept" || step === "failed";
    for (const [id, on] of Object.entries({ "set-up": step === "set-up", taps, field: step === "stroke", learning, hears: !learning && !kept, keep: kept, notes: learning || kept }))
      this.$(id).hidden = !on;
    if (taps) this.knocks = 0;
    this.$("go").hidden = taps || learning || step === "kept";
    this.$("go").textContent = { stroke: "Done", failed: "Again" }[step] ?? "Begin";
    this.$("step").textContent =
      { "set-up": "Capture a surface", "tap-in": "Tap three times", "tap-out": "Tap three times", training: "Learning", kept: "Captured", failed: "Not captured" }[step] ?? "Stroke";
    if (step !== "failed") this.trouble = "";
    if (step === "training") this.$("learning").removeAttribute("value"); // until the server says how far it is
  }

  // The input

  async listen(deviceId) {
    this.unlisten();
    const mine = (this.listening = {});
    try {
      await this.open(deviceId, mine);
    } catch (error) {
      if (this.listening !== mine) return; // the dialog was closed, or another input chosen
      this.unlisten();
      throw error;
    }
  }

  async open(deviceId, mine) {
    if (!navigator.mediaDevices) throw new Error("this browser gives no input to this page: open it over HTTPS, or at localhost");
    const off = Object.fromEntries(Object.keys(FILTERS).map((name) => [name, false]));
    let stream;
    try {
      stream = await navigator.mediaDevices.getUserMedia({ audio: { ...off, channelCount: 1, ...(deviceId && { deviceId: { exact: deviceId } }) } });
    } catch (error) {
      if (error.name === "OverconstrainedError") this.$("inputs").replaceChildren(); // so that the next attempt takes what is there
      const known = {
        NotAllowedError: "the page may not listen: allow the microphone for it",
        NotFoundError: "there is no input: plug the microphone in",
        OverconstrainedError: "this input is gone: plug it in again, or go on with another",
      };
      throw new Error(known[error.name] ?? (error.message || error.name));
    }
    if (this.listening !== mine) return stop(stream);
    this.stream = stream;
    const [track] = stream.getAudioTracks(), settings = track.getSettings();
    const on = Object.keys(FILTERS).filter((name) => settings[name] === true).map((name) => FILTERS[name]);
    if (on.length) throw new Error(`the browser does not turn off ${on.join(" and ")} of this input, which would alter the vibration: take another input or browser`);
    track.addEventListener("ended", () => this.fail("the input was unplugged"));
    const context = (this.context = new AudioContext(settings.sampleRate ? { sampleRate: settings.sampleRate } : {}));
    await context.audioWorklet.addModule("input.js");
    const node = new AudioWorkletNode(context, "foten-input", { numberOfOutputs: 0, channelCount: 1, channelCountMode: "explicit" });
    node.port.onmessage = ({ data }) => this.listening === mine && (data.piece ? this.received(data.piece) : this.lost(data.missing));
    context.createMediaStreamSource(stream).connect(node);
    await context.resume();
    const inputs = (await navigator.mediaDevices.enumerateDevices()).filter((one) => one.kind === "audioinput");
    if (this.listening !== mine) return;
    this.$("inputs").replaceChildren(...inputs.map((one, i) => new Option(one.label || `Input ${i + 1}`, one.deviceId, false, one.deviceId === settings.deviceId)));
    this.input = track.label;
    this.recallScale();
    this.levels = new Levels(context.sampleRate);
    this.peaks = [];
  }

  unlisten() {
    if (this.stream) stop(this.stream);
    this.context?.close();
    this.listening = this.stream = this.context = this.levels = null;
    for (const id of ["sensor", "full", "calibrator", "relative"]) this.$(id).disabled = true;
  }

  received(piece) {
    if (!this.levels) return;
    this.levels.add(piece, this.pad.touching);
    this.peaks.push([performance.now() / 1000, this.levels.peak]);
    if (this.peaks.length > 200) this.peaks.shift();
    const { current } = this;
    if (!current?.recording) return;
    current.addSound(piece);
    if (current.seconds > MAX_S) this.fail(`a capture has at most ${MAX_S / 60} minutes`);
  }

  lost(missing) {
    if (this.current?.recording) this.fail(`the browser lost ${missing} samples of the sound: close other pages, and try again`);
  }

  // Its sensitivity: each input has its own

  typed() {
    const [sensor, full] = ["sensor", "full"].map((id) => this.$(id).value);
    this.setScale(sensor && full ? Number(full) / Number(sensor) : null, [sensor, full]);
  }

  /** Take an acceleration [m/s²], or null, as full scale of this input, and keep it with what was typed. */
  setScale(value, fields) {
    const known = value >= FULL_SCALES[0] && value <= FULL_SCALES[1], scales = JSON.parse(localStorage.getItem("full-scales") ?? "{}");
    if (known && !NAMELESS.test(this.input)) scales[this.input] = { value, fields };
    else delete scales[this.input];
    localStorage.setItem("full-scales", JSON.stringify(scales));
    this.showScale(known ? value : null, fields);
    if (value !== null && !known) this.$("scale").value = `Expected ${FULL_SCALES.join(" to ")} m/s² at full scale`;
  }

  recallScale() {
    const { value = null, fields = ["", ""] } = JSON.parse(localStorage.getItem("full-scales") ?? "{}")[this.input] ?? {};
    this.showScale(value, fields);
    for (const id of ["sensor", "full", "calibrator", "relative"]) this.$(id).disabled = false;
  }

  showScale(value, fields) {
    this.fullScale = value;
    ["sensor", "full"].forEach((id, i) => this.$(id).value === fields[i] || (this.$(id).value = fields[i]));
    this.$("sensitivity").textContent = value ? `Sensitivity: full scale is ${value.toPrecision(3)} m/s²` : "Sensitivity: relative units";
    this.$("scale").value = !value ? "" : NAMELESS.test(this.input) ? "For this time: choose the input by its name to keep it" : "Kept for this input, at the gain that it has now";
    this.$("relative").hidden = !value;
  }

  /** A shaker moves the sensor with an RMS of 1 g: a second of it says what full scale is. */
  async calibrate() {
    const { levels } = this, add = levels.add.bind(levels);
    let squares = 0, n = 0;
    levels.add = (piece, down) => (add(piece, down), (squares += levels.rms ** 2), n++);
    this.$("scale").value = "Listening for a second";
    await new Promise((resolve) => setTimeout(resolve, 1000));
    levels.add = add;
    if (this.levels !== levels) return; // another input was chosen
    const rms = Math.sqrt(squares / Math.max(1, n));
    this.setScale(rms > 1e-3 ? AN_RMS_OF_1_G / rms : null, ["", ""]);
    if (!this.fullScale) this.$("scale").value = "Hardly anything is heard: is the calibrator on?";
  }

  // The steps

  async go() {
    if (this.step === "failed") {
      this.current = null;
      this.enter("set-up");
      if (!this.levels) await this.listen(this.$("inputs").value);
    } else if (this.step === "set-up") await this.begin();
    else if (this.step === "stroke") this.enter("tap-out");
  }

  async begin() {
    if (!this.levels) await this.listen(this.$("inputs").value);
    if (!this.levels || this.step !== "set-up") return; // closed, or pressed twice
    const { levels, fullScale } = this, name = this.$("called").value.trim() || "My surface";
    const about = { name, rate_hz: this.context.sampleRate, ...this.calibration(), input: (this.input || "audio input").slice(0, 100), ...(fullScale && { full_scale_m_s2: fullScale }) };
    levels.clipped = levels.lost = 0;
    this.touch = null;
    this.$("notes").replaceChildren();
    this.coverage.start(true);
    this.current = new CaptureSession(about, (...one) => this.answered(...one), (...one) => this.failed(...one));
    this.enter("tap-in");
    if (this.canTrain()) this.current.connect();
  }

  touched(e) {
    if (this.step !== "set-up" && this.step !== "tap-in") return;
    this.coverage.start(e.pointerType === "pen");
    if (e.pointerType !== "pen") this.trouble = `${e.pointerType === "mouse" ? "A mouse" : "A finger"} has no pressure: only speed is learned. With a pen it is force too.`;
  }

  event(x, y, pressure, seconds) {
    const { current } = this;
    if (!current?.recording) return;
    const t = seconds - current.started, { newtons, steepness } = current.about;
    current.addEvent(x, y, pressure, t);
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
    this.unlisten();
    this.current.train();
    if (this.current.socket) return this.enter("training");
    this.enter("kept");
    this.trouble = "This page has no server to learn from it: save it, and run foten import sound.wav --pen pen.csv.";
  }

  answered(captured, said) {
    const shown = captured === this.current;
    if (shown) {
      if (said.share !== undefined) this.$("learning").value = said.share;
      if (said.stage) this.trouble = sentence(said.stage);
      for (const text of [said.joined?.text, ...(said.notes ?? [])].filter(Boolean))
        this.$("notes").append(Object.assign(document.createElement("p"), { textContent: sentence(text) }));
    }
    const texture = said.done ?? said.playable;
    if (!texture) return;
    if (shown) {
      this.current = null; // it goes on without the dialog
      this.dialog.close();
    }
    this.onTexture(texture, Boolean(said.done));
  }

  failed(captured, why) {
    if (captured === this.current) return this.fail(why);
    this.unsaid.push(`${captured.about.name} ${captured.playable ? "gets no better" : "was not captured"}: ${why}`);
    if (!this.dialog.open) this.sayUnsaid(); // else it would be behind the dialog
  }

  sayUnsaid() {
    const text = this.unsaid.splice(0).join(". ");
    if (text) this.say?.(text);
  }

  /** End what the dialog shows, and say why. */
  fail(why) {
    this.current?.end();
    this.unlisten();
    this.enter("failed");
    this.$("keep").hidden = !this.current?.pieces.length;
    this.trouble = sentence(why);
  }

  keep() {
    const nLate = this.current.save();
    if (nLate) this.trouble = `${nLate} events of the pen came late, and are kept only as touches and lifts.`;
  }

  /** Let go of the input and of the capture that is shown: one that is not at its end is given up, one that learns goes on. */
  leave() {
    if (this.current?.recording) this.current.end();
    this.current = null;
    this.unlisten();
    this.sayUnsaid();
  }

  draw() {
    const { levels, step } = this;
    if (levels) {
      const db = Math.max(-80, 20 * Math.log10(Math.max(levels.rms, 1e-9)));
      this.shown = Math.max(db, (this.shown ?? -80) - 4);
      this.$("hears").setAttribute("aria-valuenow", Math.round(this.shown));
      this.$("hears").firstElementChild.style.clipPath = `inset(0 ${(-100 * this.shown) / 80}% 0 0)`;
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
      }
    }
    // Where it is, so that nothing moves under the hand when it comes.
    this.$("go").style.visibility = step === "stroke" && this.coverage.stroked < MIN_STROKES_S ? "hidden" : "";
    const text = this.trouble || (step === "stroke" ? levels?.trouble : step === "set-up" ? levels?.unfit : "") || "";
    if (this.$("trouble").textContent !== text) this.$("trouble").textContent = text;
  }
}

function stop(stream) {
  for (const track of stream.getTracks()) track.stop();
}
