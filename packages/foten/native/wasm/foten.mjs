/**
 * Haptic textures in a page, a worker, an AudioWorklet or Node: the C kernel as WebAssembly, with no dependencies.
 *
 *     import { Foten } from "./foten.mjs";
 *     const foten = await Foten.load(await (await fetch("foten.wasm")).arrayBuffer());
 *     const texture = foten.texture(await (await fetch("denim.foten")).arrayBuffer());
 *     const renderer = texture.renderer({ rate: 48000, seed: 0 });
 *     renderer.setCondition(80, 0.8);            // mm/s, N
 *     renderer.render(new Float32Array(128));    // m/s²
 *
 * Units everywhere: acceleration m/s², speed mm/s, force N, rates Hz. See foten.h for what each call means.
 */

const OPTIONS_BYTES = 32; // foten_options: double, uint64, uint64, int, int
const ACTUATOR_BYTES = 40; // foten_actuator: five doubles
const WHY_BYTES = 512;
const ABI = 7; // FOTEN_ABI of the header that this follows

export class FotenError extends Error {}

/** What the kernel knows an object by; after it was freed that is 0, where other things lie. */
function alive(object) {
  if (!object.pointer) throw new FotenError(`this ${object.constructor.name.toLowerCase()} was freed`);
  return object.pointer;
}

/** The kernel. One may run any number of textures and renderers. */
export class Foten {
  /** Compile and start the kernel from the bytes of foten.wasm, or from a WebAssembly.Module. */
  static async load(bytesOrModule) {
    const module =
      bytesOrModule instanceof WebAssembly.Module ? bytesOrModule : await WebAssembly.compile(bytesOrModule);
    return Foten.start(module);
  }

  /** The same without waiting, for an AudioWorklet that was sent a compiled module. */
  static start(module) {
    const nothing = new Proxy({}, { get: () => () => 0 });
    const imports = {};
    for (const { module: from } of WebAssembly.Module.imports(module)) imports[from] = nothing;
    return new Foten(new WebAssembly.Instance(module, imports).exports);
  }

  constructor(exports) {
    this.c = exports;
    exports._initialize?.();
    if (exports.foten_abi?.() !== ABI) throw new FotenError("foten.wasm is of another version than foten.mjs");
  }

  get version() {
    return this.text(this.c.foten_version());
  }

  get isa() {
    return this.text(this.c.foten_isa());
  }

  /** Check the bytes of a texture file (ArrayBuffer or Uint8Array) and make it ready. Throws FotenError with one line for people. */
  texture(bytes) {
    return new Texture(this, bytes instanceof Uint8Array ? bytes : new Uint8Array(bytes));
  }

  /** The kernel's noise, n numbers from `first` on. */
  noise(seed, stream, first, n) {
    return this.within(8 * n, (at) => {
      this.c.foten_noise(BigInt(seed), BigInt(stream), BigInt(first), n, at);
      return new Float64Array(this.c.memory.buffer, at, n).slice();
    });
  }

  text(at) {
    const bytes = new Uint8Array(this.c.memory.buffer, at);
    let escaped = "", plain = "";
    for (let i = 0; bytes[i]; i++) {
      escaped += `%${bytes[i].toString(16).padStart(2, "0")}`;
      plain += bytes[i] < 128 ? String.fromCharCode(bytes[i]) : "\ufffd";
    }
    try {
      return decodeURIComponent(escaped); // an AudioWorklet has no TextDecoder
    } catch {
      return plain; // a file's names need not be UTF-8
    }
  }

  take(n) {
    const at = this.c.malloc(n);
    if (!at) throw new FotenError("no memory");
    return at;
  }

  within(n, use) {
    const at = this.take(n);
    try {
      return use(at);
    } finally {
      this.c.free(at);
    }
  }
}

class Texture {
  constructor(foten, bytes) {
    this.foten = foten;
    const { c } = foten;
    this.pointer = foten.within(4 + WHY_BYTES, (at) =>
      foten.within(bytes.length || 1, (data) => {
        new Uint8Array(c.memory.buffer, data, bytes.length).set(bytes);
        if (c.foten_model_load(data, bytes.length, at, at + 4, WHY_BYTES) !== 0) throw new FotenError(foten.text(at + 4));
        return new DataView(c.memory.buffer).getUint32(at, true);
      }),
    );
    this.info = foten.within(128, (at) => {
      c.foten_model_info(at, this.pointer);
      const view = new DataView(c.memory.buffer);
      return {
        model: foten.text(view.getUint32(at, true)),
        texture: foten.text(view.getUint32(at + 4, true)),
        rate: view.getFloat64(at + 8, true),
        window: view.getInt32(at + 16, true),
        hasExcitation: view.getInt32(at + 20, true) !== 0,
        trainedSpeed: [view.getFloat64(at + 24, true), view.getFloat64(at + 32, true)],
        trainedForce: [view.getFloat64(at + 40, true), view.getFloat64(at + 48, true)],
        accelerationSd: view.getFloat64(at + 56, true),
        lowpassHz: view.getFloat64(at + 64, true),
      };
    });
  }

  /**
   * One rendering of the texture: rate of the output (its own by default), seed, stream, excitation; smooth puts conditions through
   * the low-pass of the recordings, for those that come in steps, 60 times a second say.
   */
  renderer(options = {}) {
    return new Renderer(this, options);
  }

  /** After its renderers. */
  free() {
    this.foten.c.foten_model_free(this.pointer);
    this.pointer = 0;
  }
}

class Renderer {
  constructor(texture, { rate = 0, seed = 0, stream = 0, excitation = true, smooth = false } = {}) {
    this.texture = texture;
    this.foten = texture.foten;
    const { c } = this.foten;
    this.pointer = this.foten.within(OPTIONS_BYTES, (at) => {
      const view = new DataView(c.memory.buffer);
      view.setFloat64(at, rate, true);
      view.setBigUint64(at + 8, BigInt(seed), true);
      view.setBigUint64(at + 16, BigInt(stream), true);
      view.setInt32(at + 24, excitation ? 0 : 1, true);
      view.setInt32(at + 28, smooth ? 1 : 0, true);
      return c.foten_state_new(alive(texture), at);
    });
    if (!this.pointer) throw new FotenError(`a rate of ${rate} Hz cannot be rendered of a texture of ${texture.info.rate} Hz`);
    this.rate = rate || texture.info.rate;
    this.seed = seed;
    this.room = 0;
    this.at = 0;
    this.grow(1024);
    this.conditionAt = this.foten.take(8);
  }

  grow(n) {
    if (n <= this.room) return;
    const at = this.foten.take(4 * n);
    if (this.at) this.foten.c.free(this.at);
    this.at = at;
    this.room = n;
    this.view = null;
  }

  /** What was rendered, as a view into the kernel's memory: made anew only where that has moved or the length is another one. */
  rendered(n) {
    if (this.view?.buffer !== this.foten.c.memory.buffer || this.view.length !== n)
      this.view = new Float32Array(this.foten.c.memory.buffer, this.at, n);
    return this.view;
  }

  /** Set speed and force: mm/s and N. */
  setCondition(speed, force) {
    this.foten.c.foten_set_condition(alive(this), speed, force);
  }

  /**
   * Render what drives an actuator from now on, or acceleration again (null): gain in m/s² per unit of drive; the rest may be left
   * out. With a resonance the renderer's rate has to be 4000 Hz or more, and 16 times the resonance.
   */
  setActuator(actuator) {
    const pointer = alive(this), { c } = this.foten;
    const status = !actuator
      ? c.foten_set_actuator(pointer, 0)
      : this.foten.within(ACTUATOR_BYTES, (at) => {
          const { resonanceHz = 0, damping = 0, gain, lowestHz = 0, limit = 0 } = actuator;
          new Float64Array(c.memory.buffer, at, 5).set([resonanceHz, damping, gain, lowestHz, limit]);
          return c.foten_set_actuator(pointer, at);
        });
    if (status !== 0)
      throw new FotenError(
        "the actuator's figures cannot be, or the output rate is below 4000 Hz or 16 times its resonance; render at 8000 Hz?",
      );
  }

  /** Fill a Float32Array with the next samples. Allocates only where its length is another one than before. */
  render(out) {
    const pointer = alive(this);
    this.grow(out.length);
    this.foten.c.foten_render(pointer, this.at, out.length);
    out.set(this.rendered(out.length));
    return out;
  }

  /** Fill a Float32Array under the conditions of a stylus. */
  renderStylus(stylus, out) {
    const pointer = alive(this), pen = alive(stylus);
    this.grow(out.length);
    this.foten.c.foten_render_stylus(pointer, pen, this.at, out.length);
    out.set(this.rendered(out.length));
    return out;
  }

  /** A pen on this texture; a [N] and b of force = a exp(b pressure), the paper's by default. */
  stylus({ newtons = 0, steepness = 0 } = {}) {
    return new Stylus(this.texture, newtons, steepness);
  }

  /** Begin again, with the same seed or another one. */
  reset(seed = this.seed) {
    this.foten.c.foten_reset(alive(this), BigInt(seed));
    this.seed = seed;
  }

  /** Delay of the change of rate [s]. */
  get delay() {
    return this.foten.c.foten_delay_s(alive(this));
  }

  /** Speed [mm/s] and force [N] that the last sample was rendered under. */
  get condition() {
    this.foten.c.foten_condition(alive(this), this.conditionAt, this.conditionAt + 4);
    const view = new DataView(this.foten.c.memory.buffer);
    return [view.getFloat32(this.conditionAt, true), view.getFloat32(this.conditionAt + 4, true)];
  }

  get stats() {
    return counts(this.foten, "foten_statistics", alive(this), ["n", "nSpeedBeyond", "nForceBeyond", "nSpeedClamped", "nForceClamped", "nBelow", "nSaturated", "nRefused", "nLimited", "nLost"]);
  }

  free() {
    if (!this.pointer) return;
    this.foten.c.free(this.at);
    this.foten.c.free(this.conditionAt);
    this.foten.c.foten_state_free(this.pointer);
    this.pointer = this.at = this.conditionAt = 0;
  }
}

class Stylus {
  constructor(texture, newtons, steepness) {
    this.foten = texture.foten;
    this.pointer = this.foten.within(16, (at) => {
      const view = new DataView(this.foten.c.memory.buffer);
      view.setFloat64(at, newtons, true);
      view.setFloat64(at + 8, steepness, true);
      return this.foten.c.foten_stylus_new(alive(texture), at);
    });
    if (!this.pointer) throw new FotenError("no tablet has such a curve of pressure");
  }

  /** An event: position [mm], pressure 0..1 (0 is lifted), the device's time [s]. */
  push(x, y, pressure, t) {
    this.foten.c.foten_stylus_push(alive(this), x, y, pressure, t);
  }

  get stats() {
    return counts(this.foten, "foten_stylus_statistics", alive(this), ["n", "nRefused", "nLate", "nDropped", "nClipped", "nJumps"]);
  }

  free() {
    this.foten.c.foten_stylus_free(this.pointer);
    this.pointer = 0;
  }
}

function counts(foten, call, pointer, names) {
  return foten.within(8 * names.length, (at) => {
    foten.c[call](at, pointer);
    const view = new DataView(foten.c.memory.buffer);
    return Object.fromEntries(names.map((name, i) => [name, Number(view.getBigUint64(at + 8 * i, true))]));
  });
}
