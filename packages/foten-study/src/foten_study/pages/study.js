// A participant's page: one step after another, as the server says. An answer is kept here until the server has it.
import * as choice from "./choice.js";
import { el, scale, worded, words } from "./elements.js";
import { Pad } from "./pad.js";
import * as rating from "./rating.js";
import { Settings, written } from "./settings.js";

const FORMS = { choice, rating }; // parts of the page that take the answer of a trial
const RETRY_MS = [200, 400, 800, 1000];
const ELSEWHERE = 4001; // as the server closes a page that another one takes the place of
const NOT_ALLOWED = 4002; // and one that the operator does not let go on where another device was
const RETURNED = 4003; // and one whose place was returned
const TOO_MANY = 1013; // and one that would be too many
const AGAIN_MS = 1500;
const APART_S = 0.25; // of two events of one contact
const MOST_AT_ONCE = 64; // events in a message
const now = () => performance.timeOrigin + performance.now(); // ms; the system's clock may be set back
const $ = (id) => document.getElementById(id);
const given = new URLSearchParams(location.search);

/** The sound output of the tablet, for samples that the server renders. */
class Output extends EventTarget {
  constructor() {
    super();
    this.context = null;
    this.volumeDb = 0;
    this.latency = {};
    this.underruns = 0; // of the trial
  }

  get running() {
    return this.context?.state === "running";
  }

  /** Begin to play; to be called while the browser still knows of a tap. */
  async start() {
    this.context ??= new AudioContext({ latencyHint: 0 });
    const resumed = this.context.resume();
    this.starting ??= this.connect();
    await Promise.all([resumed, this.starting]);
  }

  async connect() {
    await this.context.audioWorklet.addModule("player.js");
    this.node = new AudioWorkletNode(this.context, "foten-player", { numberOfInputs: 0, outputChannelCount: [1] });
    this.volume = new GainNode(this.context, { gain: 10 ** (this.volumeDb / 20) });
    this.node.port.onmessage = () => {
      this.underruns++;
      this.dispatchEvent(new Event("underrun"));
    };
    this.node.connect(this.volume).connect(this.context.destination);
  }

  take(block) {
    this.node?.port.postMessage(block);
  }

  /** Another trial: what is left of the last one is not played, and no under-run of this one. */
  afresh() {
    this.node?.port.postMessage({ afresh: true });
    this.underruns = 0;
  }

  setVolume(db) {
    this.volumeDb = db;
    if (this.volume) this.volume.gain.value = 10 ** (db / 20);
  }

  calibrate() {} // the server is told when the page joins

  emit() {}
}

class Study {
  constructor() {
    this.sound = new Output();
    this.surface = el("canvas", { tabIndex: 0, id: "pad", role: "application", ariaLabel: words.surface_label });
    this.sound.addEventListener("underrun", () => this.role === "stroke" && (this.counting ??= setTimeout(() => this.count(), 250)));
    this.pad = new Pad(this.surface, (...event) => this.event(...event));
    this.settings = new Settings($("panel"), this.sound, this.pad, words);
    this.role = ["stroke", "answer"].includes(given.get("role")) ? given.get("role") : "all";
    this.code = null;
    this.waiting = []; // events that go out together
    this.unstored = new Map(); // by trial: events that the server has not stored yet, and how many came before them
    this.live = false; // after a connection was lost: whether what was missed has been sent again
    this.tries = 0;
    this.joining();
    if (given.get("code")) this.join(given.get("code"));
  }

  join(code) {
    this.wanted = code;
    this.connect();
  }

  connect() {
    const socket = (this.socket = new WebSocket(new URL("session", location.href.replace(/^http/, "ws"))));
    socket.binaryType = "arraybuffer";
    this.live = false;
    socket.onopen = () => {
      const { newtons, steepness } = this.settings.calibration;
      const code = this.code ?? this.wanted, fresh = code ? {} : { fresh: this.fresh };
      const again = [...this.unstored.values()].reduce((n, { events }) => n + events.length, 0);
      this.say({ do: "join", role: this.role, rate_hz: this.sound.context?.sampleRate ?? 48000, volume_db: this.sound.volumeDb, newtons, steepness, again, ...(code && { code }), ...fresh });
    };
    socket.onmessage = ({ data }) => (typeof data === "string" ? this.told(JSON.parse(data)) : this.played(data));
    socket.onclose = ({ code }) => {
      if (socket !== this.socket) return;
      if (code === ELSEWHERE) return this.plain(words.moved_heading, words.moved);
      if (code === NOT_ALLOWED) return this.plain(words.not_allowed_heading, words.not_allowed);
      if (code === RETURNED) return location.replace(this.role === "all" ? "?" : `?role=${this.role}`); // to begin anew
      this.show(code === TOO_MANY ? words.too_many_pages : this.code ? words.no_connection : words.no_server, true);
      setTimeout(() => this.connect(), RETRY_MS[Math.min(this.tries++, RETRY_MS.length - 1)]);
    };
  }

  say(message) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  told(message) {
    if (message.joined) {
      this.code = message.joined;
      sessionStorage.removeItem("foten-fresh");
      this.plays = message.plays;
      this.tries = 0;
      history.replaceState(null, "", `?${new URLSearchParams({ code: this.code, ...(this.role !== "all" && { role: this.role }) })}`);
      this.show("");
    } else if (message.asks) {
      this.step = null; // what is shown once it is allowed is shown anew
      this.plain(words.one_moment, worded("asks", { n: message.asks }));
      this.show("");
    } else if (message.refused) this.refused(message);
    else if (message.feedback) this.show(message.feedback.right ? words.right : worded("wrong", { n: message.feedback.was }));
    else if (message.stored !== undefined) this.stored(message.trial, message.stored);
    else if (message.step) this.arrive(message.step);
  }

  refused({ refused: why, step, again }) {
    this.show(why);
    this.busy(false);
    if (!this.code) {
      const { socket } = this;
      this.socket = null;
      socket.close();
      return;
    }
    if (!this.pending || step !== this.pending.step) return;
    const { pending } = this;
    if (again) {
      setTimeout(() => this.pending === pending && this.say(pending), AGAIN_MS); // it is good, and kept
      return;
    }
    this.pending = null; // the participant decides
    localStorage.removeItem(this.kept);
    this.busy(false);
  }

  /** A code of this page's own: one that asks again, since the answer was lost, is no second participant. */
  get fresh() {
    const letters = "ABCDEFGHJKMNPQRSTUVWXYZ";
    let code = sessionStorage.getItem("foten-fresh");
    if (!code) {
      code = Array.from(crypto.getRandomValues(new Uint32Array(5)), (value) => letters[value % letters.length]).join("");
      sessionStorage.setItem("foten-fresh", code);
    }
    return code;
  }

  get kept() {
    return `foten-study-${this.code}`;
  }

  /** Give an answer; it is kept until the server shows another step. */
  done(answer) {
    this.pending = { do: "done", step: this.step.id, ...answer };
    localStorage.setItem(this.kept, JSON.stringify(this.pending));
    this.busy(true);
    this.say(this.pending);
  }

  /** The server has stored so many events of a trial: the others are kept, and sent again where it is lost before. */
  stored(id, n) {
    const unstored = this.unstored.get(id);
    if (!unstored || !this.live) return; // the server waits for as many as it was promised
    unstored.events.splice(0, Math.max(0, n - unstored.base));
    unstored.base = Math.max(unstored.base, n);
    if (!unstored.events.length && id !== this.step?.id) this.unstored.delete(id);
  }

  /** Send what is not known to be stored, also of trials before; the server leaves out what it has. */
  sendAgain(step) {
    for (const { trial, base, events } of this.unstored.values())
      for (let i = 0, n = 0; i < events.length; i += n) {
        const [interval] = events[i]; // a message is of one surface
        n = 1;
        while (n < MOST_AT_ONCE && events[i + n]?.[0] === interval) n++;
        const bytes = new Uint8Array(10 + 32 * n), view = new DataView(bytes.buffer);
        bytes.set(["m".charCodeAt(0), interval]);
        view.setInt32(2, trial, true);
        view.setInt32(6, base + i, true);
        bytes.set(new Uint8Array(Float64Array.from(events.slice(i, i + n).flatMap(([, ...event]) => event)).buffer), 10);
        this.socket.send(bytes);
      }
    const here = this.step;
    if (here?.id === step.id && here.interval !== step.interval) this.say({ do: "side", side: "virtual", interval: here.interval });
  }

  arrive(step) {
    if (!this.live) this.sendAgain(step);
    this.live = true;
    this.pending ??= JSON.parse(localStorage.getItem(this.kept) ?? "null");
    if (this.pending?.step === step.id) {
      this.say(this.pending); // of before the connection broke
      if (this.step?.id === step.id) return;
    } else if (this.pending) {
      this.pending = null;
      localStorage.removeItem(this.kept);
    }
    const same = this.step?.id === step.id;
    if (!same) this.touched = new Set(step.touched);
    this.step = step;
    $("simulated").hidden = !step.simulated;
    const counts = step.kind === "trial" || step.kind === "break";
    $("progress").hidden = !counts;
    $("progress").value = counts ? Math.max(0, step.n - (step.kind === "trial" ? 1 : 0)) / step.of : 0;
    $("count").value = !counts ? "" : step.practice ? words.practice : `${written(Math.max(1, step.n))} / ${written(step.of)}`;
    if (!same) this.page(step);
    else if (step.kind === "trial") this.side(step.side, step.interval);
    if (step.kind === "trial") this.hold(step.held);
    this.busy(Boolean(this.pending));
  }

  show(text, stays = false) {
    clearTimeout(this.hiding);
    $("message").textContent = text;
    $("message").hidden = !text;
    if (text && !stays) this.hiding = setTimeout(() => ($("message").hidden = true), 7000);
  }

  busy(on) {
    const lacks = this.lacks?.() ?? "";
    for (const button of document.querySelectorAll("#content .big")) button.disabled = on || Boolean(button.dataset.needs && lacks);
    if ($("lacks")) $("lacks").textContent = on ? words.one_moment : lacks;
  }

  put(...children) {
    this.lacks = null;
    $("content").replaceChildren(...children);
  }

  joining() {
    const code = el("input", { id: "code", type: "text", maxLength: 5, autocomplete: "off", ariaLabel: words.code, placeholder: words.code });
    this.put(
      el("form", { className: "page", onsubmit: (e) => (e.preventDefault(), this.busy(true), this.start().then(() => this.join(code.value.trim() || null))) },
        el("h2", {}, words.welcome),
        el("p", {}, words.welcome_how),
        code,
        el("button", { className: "big", type: "submit" }, words.begin),
        el("button", { className: "link", type: "button", onclick: () => this.settings.show() }, words.set_up),
      ),
    );
  }

  page(step) {
    const { kind, n, of, text } = step;
    const plain = {
      consent: [words.consent_heading, text, words.agree],
      instructions: [words.instructions_heading, text, words.start],
      break: [words.break_heading, worded("break", { n: written(n ?? 0), total: written(of ?? 0) }), words.go_on],
      end: [words.end_heading, words.end],
    };
    if (plain[kind]) this.plain(...plain[kind]);
    else (kind === "trial" ? this.trial : this.questions).call(this, step);
  }

  /** A page that is read, and left by a button if it has one. */
  plain(heading, text, label) {
    this.put(el("div", { className: "page" }, el("h2", {}, heading), el("p", {}, text), label && this.next(label)));
  }

  next(label) {
    return el("button", { className: "big", type: "button", onclick: () => (this.busy(true), this.start().then(() => this.done({}))) }, label);
  }

  questions({ questions }) {
    const form = el("form", { className: "page" });
    const fields = questions.map((question) => this.question(question));
    form.append(el("h2", {}, words.questions_heading), ...fields.map(({ element }) => element), el("button", { className: "big", type: "submit" }, words.next));
    form.addEventListener("submit", (e) => {
      e.preventDefault();
      this.done({ answers: Object.fromEntries(questions.map((question, i) => [question.key, fields[i].value()])) });
    });
    this.put(form);
  }

  question({ key, text, kind, options, required, low, high }) {
    const label = required ? text : worded("if_you_like", { question: text });
    // In the study's language, which need not be the browser's; what is wrong is wrong until someone changes it.
    const checks = {
      oninvalid: ({ target, target: { validity: { badInput, rangeUnderflow, rangeOverflow } } }) => {
        const bounds = rangeUnderflow || rangeOverflow ? ` (${low}–${high})` : "";
        target.setCustomValidity(worded(badInput || bounds ? "not_a_number" : "answer_missing", { question: text + bounds }));
      },
      oninput: ({ target }) => document.getElementsByName(target.name).forEach((input) => input.setCustomValidity("")),
    };
    if (kind === "choice") {
      const inputs = options.map((option) => el("input", { type: "radio", name: key, value: option, required, ...checks }));
      return {
        element: el("fieldset", {}, el("legend", {}, label), ...inputs.map((input) => el("label", { className: "choice" }, input, el("span", {}, input.value)))),
        value: () => inputs.find((input) => input.checked)?.value ?? "",
      };
    }
    if (kind === "slider") {
      const { input, element } = scale(written(0), written(100), label);
      return { element: el("div", {}, el("p", {}, label), element), value: () => (input.dataset.set ? input.value : "") };
    }
    const input = kind === "number" ? el("input", { type: "number", step: "any", min: low, max: high, required, name: key, ...checks }) : el("textarea", { rows: 2, maxLength: 2000, required, name: key, ...checks });
    return { element: el("label", {}, label, input), value: () => input.value };
  }

  trial(step) {
    const { role } = this, strokes = role !== "answer", answers = role !== "stroke";
    const box = el("div", { className: `trial ${role}` });
    this.answer = null;
    if (strokes) {
      this.realButton = step.real_side === "none" ? null : el("button", { className: "real", type: "button", onclick: () => this.turn("real") }, words.real_surface);
      this.tabs = step.intervals.map((name, i) => el("button", { type: "button", ariaLabel: worded("surface_n", { n: name }), onclick: () => this.turn("virtual", i) }, name));
      const tabs = this.tabs.length ? el("div", { className: "intervals", role: "group" }, ...this.tabs) : null;
      this.virtual = el("div", { className: "virtual" }, this.surface, step.name ? el("b", {}, step.name) : null, tabs, el("div", { className: "held", hidden: !step.held }, words.one_moment));
      box.append(el("div", { className: `surfaces ${step.real_side}` }, this.virtual, this.realButton ?? ""));
      this.picture(step.picture);
    }
    if (answers) {
      const answer = FORMS[step.form].answer(step, () => this.check());
      const next = el("button", { className: "big", type: "button", onclick: () => this.done({ values: answer.values(), seconds: this.seconds, ...(strokes && { underruns: this.sound.underruns }) }) }, words.next);
      next.dataset.needs = "rating";
      next.setAttribute("aria-describedby", "lacks");
      if (this.pending?.step === step.id) answer.set(this.pending.values); // as it was chosen before the page was loaded again
      if (step.min_s) setTimeout(() => this.check(), 1000 * step.min_s + 50);
      box.append(el("section", { className: "rate", ariaLabel: words.rating }, ...answer.elements, el("p", { id: "lacks" }), next));
      this.answer = answer;
    }
    this.begin(step.id);
    for (const [id, { events }] of this.unstored) if (!events.length && id !== step.id) this.unstored.delete(id);
    if (!this.unstored.has(step.id)) this.unstored.set(step.id, { trial: step.n, base: step.stored, events: [] });
    this.sound.afresh();
    if (role === "stroke") this.count();
    this.put(box);
    this.lacks = answers ? () => this.lacking() : null;
    this.pad.resize();
    this.side(step.side, step.interval);
  }

  /** What a trial lacks before it can be answered, in words; empty where it lacks nothing. */
  lacking() {
    const { step } = this, stroked = this.role !== "all" || this.touched.size >= Math.max(1, step.intervals.length);
    if (step.held) return words.one_moment;
    if (step.min_s && !stroked) return step.intervals.length ? words.stroke_each : words.stroke_first;
    if (step.lacks_real) return worded("touch_real", { real: words.real_surface });
    if (this.seconds < step.min_s) return worded(step.real_side === "none" ? "wait" : "explore_first", { s: written(Math.ceil(step.min_s)) });
    return this.answer?.given() ? "" : this.answer?.lacks;
  }

  check() {
    this.busy(Boolean(this.pending));
  }

  /** Count from when a trial is shown first, a page that is loaded again too; not while it is held. */
  begin(id) {
    const known = JSON.parse(sessionStorage.getItem("foten-begun") ?? "null");
    const goes = known?.id === id && known.code === this.code && Math.max(known.at, known.since) <= now();
    this.clock = goes ? known : { id, code: this.code, at: now(), held: 0, since: null };
  }

  hold(held) {
    const { clock } = this;
    if (held) clock.since ??= now();
    else if (clock.since !== null) [clock.held, clock.since] = [clock.held + now() - clock.since, null];
    sessionStorage.setItem("foten-begun", JSON.stringify(clock));
    const cover = document.querySelector(".held");
    if (cover) cover.hidden = !held;
    this.check();
  }

  get seconds() {
    const { clock } = this;
    return ((clock.since ?? now()) - clock.at - clock.held) / 1000;
  }

  async picture(url) {
    this.pad.setTile(null, 24);
    if (!url) return;
    const photo = new Image();
    photo.src = url;
    await photo.decode().then(() => this.pad.setTile(photo, 24), () => {});
  }

  side(side, interval) {
    Object.assign(this.step, { side, interval });
    this.realButton?.setAttribute("aria-pressed", String(side === "real"));
    this.virtual?.parentElement?.classList.toggle("on-real", side === "real");
    this.tabs?.forEach((tab, i) => tab.setAttribute("aria-pressed", String(side === "virtual" && i === interval)));
    this.mark();
  }

  /** Show which surfaces were stroked. */
  mark() {
    this.tabs?.forEach((tab, i) => tab.classList.toggle("stroked", this.touched.has(i)));
  }

  turn(side, interval = this.step?.interval) {
    const { step } = this;
    if (step?.kind !== "trial" || (step.side === side && step.interval === interval)) return;
    this.side(side, interval);
    this.say({ do: "side", side, ...(step.intervals.length && { interval }) });
  }

  /** From a tap: browsers ask for one before they play. */
  async start() {
    if (this.plays === false || this.role === "answer") return;
    try {
      await this.sound.start();
    } catch (error) {
      console.error(error);
      this.show(words.cannot_play);
    }
  }

  event(x, y, pressure, t) {
    const { step } = this;
    if (step?.kind !== "trial" || step.held) return;
    if (pressure && step.side === "real") this.turn("virtual");
    if (step.side === "real") return;
    if (!this.sound.running) this.start();
    const { last } = this; // contact is counted as the server counts it: a pen that only rests there strokes nothing
    if (last?.pressure && last.interval === step.interval && t > last.t && t - last.t <= APART_S && !this.touched.has(step.interval)) {
      this.touched.add(step.interval);
      this.mark();
      this.check();
    }
    this.last = { pressure, interval: step.interval, t };
    this.waiting.push([x, y, pressure, t]);
    if (this.waiting.length > 1) return;
    queueMicrotask(() => {
      const { step } = this; // also while the server is away:
      this.unstored.get(step?.id)?.events.push(...this.waiting.map((event) => [step.interval, ...event]));
      if (this.live && this.socket.readyState === WebSocket.OPEN)
        for (let i = 0; i < this.waiting.length; i += MOST_AT_ONCE) this.socket.send(Float64Array.from(this.waiting.slice(i, i + MOST_AT_ONCE).flat()));
      this.waiting = [];
    });
  }

  /** Say how many under-runs the trial has had, where another page takes its answer. */
  count() {
    clearTimeout(this.counting);
    this.counting = null;
    if (this.step?.kind === "trial") this.say({ do: "count", step: this.step.id, underruns: this.sound.underruns });
  }

  played(data) {
    const [speed, force] = new Float32Array(data, 0, 2);
    this.sound.take({ samples: new Float32Array(data, 8), speed, force });
  }
}

window.study = new Study(); // for tests and the curious
document.documentElement.dataset.ready = "true";
