// Renders on the audio thread, 128 samples a call: a texture by the kernel, or what a server streams.
import { Foten } from "./foten.mjs";
import { limited, Stream } from "./stream.js";

const FADE = 512; // samples of a change from one texture to another
const QUANTA = 6; // of 128 samples between reports: 62 times a second at 48 kHz
const RAMP_S = 0.05; // in which a tone begins, and ends
const LAST_EVENTS = 16; // that a texture is given which takes over during a stroke

class Contact extends AudioWorkletProcessor {
  constructor({ processorOptions: { module } }) {
    super();
    this.foten = Foten.start(module);
    this.textures = new Map(); // by id: { texture, renderer, stylus, scale }
    this.current = this.leaving = null;
    this.left = 0; // samples until what leaves has faded
    this.calibration = {};
    this.actuator = null;
    this.last = [];
    this.quanta = 0;
    this.peaks = new Float32Array(2 * QUANTA);
    this.squares = 0;
    this.quantum = new Float32Array(128);
    this.recording = null;
    this.waiting = null; // the event whose delay is being measured
    this.stream = null; // what a server renders, and waits here to be played
    this.tones = null; // that play alone, and how far they are
    this.port.onmessage = ({ data }) => {
      try {
        this[data.do](data);
      } catch (error) {
        this.port.postMessage({ failed: error.message, id: data.id });
      }
    };
  }

  load({ id, bytes, seed }) {
    this.drop({ id });
    const texture = this.foten.texture(bytes);
    const one = { texture, seed: seed ?? 0, renderer: texture.renderer({ rate: sampleRate, seed: seed ?? 0 }) };
    one.stylus = one.renderer.stylus(this.calibration);
    if (this.actuator) one.renderer.setActuator(this.actuator);
    this.textures.set(id, one);
    this.port.postMessage({ loaded: id, info: texture.info });
  }

  drop({ id }) {
    const one = this.textures.get(id);
    if (!one) return;
    for (const role of ["current", "leaving"]) if (this[role] === one) this[role] = null;
    this.textures.delete(id);
    one.stylus.free();
    one.renderer.free();
    one.texture.free();
  }

  /** Go over to a texture, in the middle of a stroke too; `scale` makes its m/s² full scale. */
  use({ id, scale }) {
    const one = this.textures.get(id);
    if (!one) return;
    one.scale = scale;
    if (one === this.current) return;
    if (this.current) [this.leaving, this.left] = [this.current, FADE];
    this.begin(one);
    for (const event of this.last) one.stylus.push(...event);
    this.current = one;
  }

  begin(one) {
    one.stylus.free();
    one.stylus = one.renderer.stylus(this.calibration);
    one.renderer.reset(one.seed);
  }

  event({ event, id }) {
    this.current?.stylus.push(...event);
    this.last.push(event);
    if (this.last.length > LAST_EVENTS) this.last.shift();
    if (id !== undefined && this.waiting === null) this.waiting = id;
    this.recording?.events.push([this.recording.n, ...event]);
  }

  /** Play tones, and nothing else meanwhile: when [s], Hz, peak of full scale and length [s] of each. */
  burst({ tones, seconds }) {
    this.tones = { list: tones, n: 0, end: seconds * sampleRate };
  }

  sing(out) {
    const { tones } = this;
    for (let i = 0; i < out.length; i++, tones.n++) {
      out[i] = 0;
      for (const [begin, hz, peak, length] of tones.list) {
        const t = tones.n / sampleRate - begin;
        if (t < 0 || t >= length) continue;
        const ramp = Math.min(1, t / RAMP_S, (length - t) / RAMP_S);
        out[i] += peak * (0.5 - 0.5 * Math.cos(Math.PI * ramp)) * Math.sin(2 * Math.PI * hz * t);
      }
    }
    if (tones.n >= tones.end) this.tones = null;
    return true;
  }

  /** Play what comes from a server. */
  listen({ on, scale }) {
    if (on && this.stream) this.stream.scale = scale;
    else this.stream = on ? new Stream(scale) : null;
  }

  /** An event that a server renders. */
  note({ event }) {
    this.recording?.events.push([this.recording.n, ...event]);
  }

  take(block) {
    this.stream?.take(block);
  }

  calibrate({ newtons, steepness }) {
    this.calibration = { newtons, steepness };
    for (const one of this.textures.values()) this.begin(one);
  }

  actuate({ actuator }) {
    this.actuator = actuator;
    for (const one of this.textures.values()) one.renderer.setActuator(actuator);
  }

  /** Keep what is rendered, from a fresh beginning: the same events then give the same samples in every renderer of the file. */
  record({ on }) {
    if (on && this.stream) this.recording = { n: 0, events: [], blocks: [], seed: null };
    else if (on && this.current) {
      this.begin(this.current);
      this.last = [];
      this.recording = { n: 0, events: [], blocks: [], seed: this.current.seed };
    } else if (this.recording) {
      const { n, events, blocks, seed } = this.recording;
      const samples = new Float32Array(n);
      blocks.forEach((block, i) => samples.set(block, i * this.quantum.length));
      this.port.postMessage({ recorded: { samples, events, seed, rate: sampleRate } }, [samples.buffer]);
      this.recording = null;
    }
  }

  process(_inputs, [[out]]) {
    if (this.tones) return this.sing(out);
    if (this.stream) return this.play(out);
    const one = this.current, { quantum } = this;
    if (!one) return true;
    one.renderer.renderStylus(one.stylus, quantum);
    this.keep(quantum);
    this.measure(quantum, one.renderer);
    for (let i = 0; i < out.length; i++) out[i] = one.scale * quantum[i];
    if (this.leaving) this.fade(out);
    for (let i = 0; i < out.length; i++) out[i] = limited(out[i]);
    if (this.waiting !== null) {
      this.port.postMessage({ taken: this.waiting, frame: currentFrame });
      this.waiting = null;
    }
    return true;
  }

  play(out) {
    const { stream, quantum } = this;
    stream.fill(quantum);
    this.keep(quantum);
    this.measure(quantum, { condition: [stream.speed, stream.force] });
    for (let i = 0; i < out.length; i++) out[i] = limited(stream.scale * quantum[i]);
    return true;
  }

  keep(quantum) {
    if (!this.recording) return;
    this.recording.blocks.push(quantum.slice());
    this.recording.n += quantum.length;
  }

  fade(out) {
    const { leaving, quantum } = this;
    leaving.renderer.renderStylus(leaving.stylus, quantum);
    for (let i = 0; i < out.length; i++) {
      const share = Math.max(0, this.left-- / FADE);
      out[i] = (1 - share) * out[i] + share * leaving.scale * quantum[i];
    }
    if (this.left <= 0) this.leaving = null;
  }

  measure(samples, from) {
    let low = Infinity, high = -Infinity;
    for (const sample of samples) {
      low = Math.min(low, sample);
      high = Math.max(high, sample);
      this.squares += sample * sample;
    }
    this.peaks[2 * this.quanta] = low;
    this.peaks[2 * this.quanta + 1] = high;
    if (++this.quanta < QUANTA) return;
    const [speed, force] = from.condition;
    const rms = Math.sqrt(this.squares / (QUANTA * samples.length));
    this.port.postMessage({ report: { peaks: this.peaks.slice(), rms, speed, force, n: QUANTA * samples.length } });
    this.quanta = this.squares = 0;
  }
}

registerProcessor("foten-contact", Contact);
