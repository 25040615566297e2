// Sound in the page: the kernel in an AudioWorklet. Nothing leaves the device.
//
//     const sound = new PageSound();
//     await sound.start();                       // from a tap: browsers ask for one
//     await sound.load(id, bytes);               // a texture file
//     sound.use(id);
//     sound.push(xMm, yMm, pressure, seconds);   // as the events come
//
// Rendering is in m/s²; one standard deviation of the recording becomes LOUDNESS of full scale before the volume.

export const LOUDNESS = 0.1;
const MEASURED = 500; // delays that the percentiles are of

export class PageSound extends EventTarget {
  constructor() {
    super();
    this.context = this.node = null;
    this.loading = new Map(); // by id: those who wait for the worklet's answers, which come in their order
    this.infos = new Map();
    this.volumeDb = -6;
    this.routed = null; // the output and channel that were chosen
    this.gains = new Map(); // dB by id, that make methods equally loud
    this.delays = [];
    this.sent = new Map();
    this.measured = 0;
    this.nEvents = 0;
    this.server = null; // where sound may come from instead
    this.module = fetch(new URL("foten.wasm", import.meta.url)).then((answer) => answer.arrayBuffer()).then((bytes) => WebAssembly.compile(bytes));
  }

  get running() {
    return this.context?.state === "running";
  }

  /** Begin to play; a second call goes on. To be called while the browser still knows of a tap. */
  async start() {
    this.context ??= new AudioContext({ latencyHint: localStorage.getItem("buffer") === "steady" ? "interactive" : 0 });
    const resumed = this.context.resume();
    this.starting ??= this.connect();
    await Promise.all([resumed, this.starting]);
  }

  async connect() {
    const { context } = this;
    const [module] = await Promise.all([this.module, context.audioWorklet.addModule(new URL("worklet.js", import.meta.url))]);
    this.node = new AudioWorkletNode(context, "foten-contact", {
      numberOfInputs: 0,
      outputChannelCount: [1],
      processorOptions: { module },
    });
    this.node.port.onmessage = ({ data }) => this.answered(data);
    this.node.onprocessorerror = () => this.emit("failed", "the audio thread stopped: load the page again");
    this.analyser = new AnalyserNode(context, { fftSize: 4096, smoothingTimeConstant: 0 });
    this.volume = new GainNode(context, { gain: this.gain });
    this.output = new AnalyserNode(context, { fftSize: 2048 }); // what leaves
    this.node.connect(this.analyser);
    this.node.connect(this.volume).connect(this.output).connect(context.destination);
    if (this.routed) await this.play(...this.routed).catch(({ message }) => this.emit("failed", `the output that was chosen does not play: ${message}`));
  }

  /** Channels of the output that is played on. */
  get channels() {
    return this.context?.destination.maxChannelCount ?? 2;
  }

  /** Play on an output of this machine by its id, "" for the usual one, and on one of its channels, from 0; null for all of them. */
  async route(deviceId, channel) {
    if (this.output) await this.play(deviceId, channel);
    this.routed = [deviceId, channel]; // which plays, or is tried as the sound begins
  }

  async play(deviceId, channel) {
    const { context } = this, { destination } = context;
    if (context.setSinkId && context.sinkId !== deviceId) await context.setSinkId(deviceId);
    this.output.disconnect();
    if (channel === null || channel >= this.channels) {
      [destination.channelCount, destination.channelInterpretation] = [Math.min(2, this.channels), "speakers"];
      this.output.connect(destination);
      return;
    }
    [destination.channelCount, destination.channelInterpretation] = [this.channels, "discrete"];
    const merger = new ChannelMergerNode(context, { numberOfInputs: this.channels });
    this.output.connect(merger, 0, channel);
    merger.connect(destination);
  }

  answered(data) {
    if (data.report) this.emit("report", data.report);
    else if (data.taken !== undefined) this.measure(data);
    else if (data.loaded !== undefined) {
      this.infos.set(data.loaded, data.info);
      this.settle(data.loaded, (waiting) => waiting.resolve(data.info));
    } else if (data.recorded) this.emit("recorded", data.recorded);
    else if (data.failed && this.loading.has(data.id)) this.settle(data.id, (waiting) => waiting.reject(new Error(data.failed)));
    else if (data.failed) this.emit("failed", data.failed);
  }

  settle(id, how) {
    const [first, ...others] = this.loading.get(id) ?? [];
    if (others.length) this.loading.set(id, others);
    else this.loading.delete(id);
    if (first) how(first);
  }

  emit(type, detail) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }

  post(message) {
    this.node?.port.postMessage(message);
  }

  /** Check a texture file and make it ready: resolves to what it says of itself, rejects with a line for people. */
  async load(id, bytes, seed = 0) {
    await this.starting;
    const answer = new Promise((resolve, reject) => this.loading.set(id, [...(this.loading.get(id) ?? []), { resolve, reject }]));
    this.post({ do: "load", id, bytes, seed });
    return answer;
  }

  /** Take in what a texture says of itself that is rendered elsewhere. */
  know(id, info) {
    this.infos.set(id, info);
  }

  use(id) {
    const info = this.infos.get(id);
    if (!info) return;
    this.id = id;
    this.post({ do: "use", id, scale: this.scale(id) });
    this.server?.open(id, this.scale(id));
  }

  /** Have the sound rendered by the server, which sends it here (`stream`) or plays it itself (`device`); null for this page. */
  async from(sink) {
    const mine = (this.choosing = {});
    this.server?.close();
    this.server = null;
    this.post({ do: "listen", on: false });
    this.setVolume(this.volumeDb);
    if (!sink) return;
    const server = new Server(this, sink);
    await server.opened;
    if (this.choosing !== mine) return server.socket.close(); // another was chosen meanwhile
    this.server = server;
    this.setVolume(this.volumeDb);
    if (this.id) server.open(this.id, this.scale(this.id));
  }

  /** What becomes full scale of one of what is rendered: of an actuator's drive, of which full scale is known, or of m/s². */
  scale(id) {
    const one = this.actuator ? 1 / this.actuator.fullScale : LOUDNESS / this.infos.get(id).accelerationSd;
    return one * 10 ** ((this.gains.get(id) ?? 0) / 20);
  }

  drop(id) {
    this.infos.delete(id);
    this.post({ do: "drop", id });
  }

  /** Take in an event: position [mm], pressure 0 … 1 (0 is lifted), the event's own time [s]. */
  push(x, y, pressure, t) {
    if (this.server) {
      this.server.push(x, y, pressure, t);
      this.post({ do: "note", event: [x, y, pressure, t] });
      return;
    }
    const message = { do: "event", event: [x, y, pressure, t] };
    if (this.nEvents++ % 8 === 0 && this.sent.size < 32) {
      message.id = this.nEvents;
      this.sent.set(message.id, 1000 * t);
    }
    this.post(message);
  }

  /** Volume [dB] at the server, with what makes methods equally loud. */
  get levelDb() {
    return this.volumeDb <= -40 ? -60 : Math.min(24, Math.max(-60, this.volumeDb + (this.gains.get(this.id) ?? 0)));
  }

  get gain() {
    return 10 ** (this.volumeDb / 20);
  }

  setVolume(db) {
    this.volumeDb = db;
    this.server?.say({ do: "volume", volume_db: this.levelDb });
    const silent = db <= -40 || this.server?.sink === "device"; // which plays it there
    this.volume?.gain.setTargetAtTime(silent ? 0 : this.gain, this.context.currentTime, 0.01);
  }

  /** Make methods equally loud: dB by id. */
  match(gains) {
    this.gains = new Map(Object.entries(gains));
    if (this.id) this.use(this.id);
  }

  calibrate({ newtons, steepness }) {
    this.calibration = { newtons, steepness };
    this.server?.say({ do: "calibrate", newtons, steepness });
    this.post({ do: "calibrate", newtons, steepness });
  }

  /** Drive an actuator, or none: { resonanceHz, damping, gain, lowestHz, limit, fullScale }. */
  actuate(actuator) {
    this.actuator = actuator;
    this.server?.actuate();
    this.post({ do: "actuate", actuator });
    if (this.id) this.use(this.id);
  }

  /** Play tones alone, for so many seconds: [when, Hz, peak of full scale, length] each. */
  burst(tones, seconds) {
    this.post({ do: "burst", tones, seconds });
  }

  record(on) {
    this.post({ do: "record", on });
  }

  /** From an event to the first sample that knows of it: in the graph, and with what the device adds. */
  measure({ taken, frame }) {
    const at = this.sent.get(taken);
    this.sent.delete(taken);
    for (const id of this.sent.keys()) if (id < taken) this.sent.delete(id);
    const { contextTime, performanceTime } = this.context.getOutputTimestamp();
    if (at === undefined || !performanceTime) return;
    const played = performanceTime + 1000 * (frame / this.context.sampleRate - contextTime);
    const device = 1000 * (this.context.outputLatency || this.context.baseLatency || 0);
    if (this.delays.length >= MEASURED) this.delays.shift();
    this.delays.push([played - at, played - at - device]);
  }

  get latency() {
    const of = (i, share) => {
      const sorted = this.delays.map((delay) => delay[i]).sort((a, b) => a - b);
      return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] : null;
    };
    return {
      n: this.delays.length,
      totalP50: of(0, 0.5),
      totalP99: of(0, 0.99),
      ownP50: of(1, 0.5),
      ownP99: of(1, 0.99),
      buffer: this.context ? 1000 * (this.context.baseLatency || 0) : null,
      device: this.context ? 1000 * (this.context.outputLatency || 0) : null,
      rate: this.context?.sampleRate,
    };
  }
}

/** Sound that the server renders: events out, samples in. */
class Server {
  constructor(sound, sink) {
    Object.assign(this, { sound, sink, waiting: [], state: null, texture: null });
    const socket = (this.socket = new WebSocket(new URL("stroke", location.href.replace(/^http/, "ws"))));
    socket.binaryType = "arraybuffer";
    this.opened = new Promise((resolve, reject) => {
      socket.onopen = resolve;
      socket.onerror = () => reject(new Error("the server cannot be reached"));
    });
    socket.onmessage = ({ data }) => (typeof data === "string" ? this.answered(JSON.parse(data)) : this.played(data));
    socket.onclose = ({ reason }) => {
      if (this.sound.server !== this) return;
      this.sound.from("");
      this.sound.emit("path", "");
      this.sound.emit("failed", `the server is gone${reason ? `: ${reason}` : ""}: this page renders what it can`);
    };
  }

  open(texture, scale) {
    Object.assign(this, { texture, state: null });
    this.sound.post({ do: "listen", on: true, scale });
    this.say({ do: "open", texture, sink: this.sink, rate_hz: this.sound.context.sampleRate, volume_db: this.sound.levelDb, ...this.sound.calibration });
    this.actuate();
  }

  actuate() {
    const one = this.sound.actuator;
    this.say({ do: "actuate", ...(one && { resonance_hz: one.resonanceHz, damping: one.damping, gain: one.gain, lowest_hz: one.lowestHz, limit: one.limit, full_scale: one.fullScale }) });
  }

  /** Tell the server, which takes nothing before a texture: what is said earlier is said again as one is opened. */
  say(message) {
    if (this.texture && this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /** Events go out together that come together: those of one frame of the browser's. */
  push(...event) {
    if (!this.texture) return;
    this.waiting.push(event);
    if (this.waiting.length > 1) return;
    queueMicrotask(() => {
      if (this.socket.readyState === WebSocket.OPEN)
        for (let i = 0; i < this.waiting.length; i += 64) this.socket.send(Float64Array.from(this.waiting.slice(i, i + 64).flat()));
      this.waiting = [];
    });
  }

  answered(message) {
    if (message.refused && !this.state) this.sound.from("").then(() => this.sound.emit("path", "")); // it cannot play: this page does
    if (message.refused) this.sound.emit("failed", message.refused);
    if (message.state) this.state = message.state;
  }

  played(data) {
    const [speed, force] = new Float32Array(data, 0, 2), samples = new Float32Array(data, 8);
    this.sound.post({ do: "take", samples, speed, force });
  }

  close() {
    this.sound.server = null;
    this.socket.close();
  }
}
