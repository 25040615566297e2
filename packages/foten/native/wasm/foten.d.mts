/** Haptic textures as WebAssembly: see foten.mjs. Units: acceleration m/s², speed mm/s, force N, rates Hz, positions mm. */

export class FotenError extends Error {}

export class Foten {
  static load(bytesOrModule: BufferSource | WebAssembly.Module): Promise<Foten>;
  static start(module: WebAssembly.Module): Foten;
  readonly version: string;
  readonly isa: string;
  texture(bytes: ArrayBuffer | Uint8Array): Texture;
  noise(seed: number | bigint, stream: number | bigint, first: number | bigint, n: number): Float64Array;
}

export interface TextureInfo {
  readonly model: string;
  readonly texture: string;
  readonly rate: number;
  readonly window: number;
  readonly hasExcitation: boolean;
  readonly trainedSpeed: readonly [number, number];
  readonly trainedForce: readonly [number, number];
  readonly accelerationSd: number;
  readonly lowpassHz: number;
}

export interface RendererOptions {
  rate?: number;
  seed?: number | bigint;
  stream?: number | bigint;
  excitation?: boolean;
  smooth?: boolean;
}

declare class Texture {
  readonly info: TextureInfo;
  renderer(options?: RendererOptions): Renderer;
  free(): void;
}

export interface RendererStats {
  readonly n: number;
  readonly nSpeedBeyond: number;
  readonly nForceBeyond: number;
  readonly nSpeedClamped: number;
  readonly nForceClamped: number;
  readonly nBelow: number;
  readonly nSaturated: number;
  readonly nRefused: number;
  readonly nLimited: number;
  readonly nLost: number;
}

/** Its gain is in m/s² per unit of drive. */
export interface Actuator {
  resonanceHz?: number;
  damping?: number;
  gain: number;
  lowestHz?: number;
  limit?: number;
}

declare class Renderer {
  readonly rate: number;
  readonly delay: number;
  readonly condition: [speed: number, force: number];
  readonly stats: RendererStats;
  setCondition(speed: number, force: number): void;
  setActuator(actuator: Actuator | null): void;
  render(out: Float32Array): Float32Array;
  renderStylus(stylus: Stylus, out: Float32Array): Float32Array;
  stylus(curve?: { newtons?: number; steepness?: number }): Stylus;
  reset(seed?: number | bigint): void;
  free(): void;
}

export interface StylusStats {
  readonly n: number;
  readonly nRefused: number;
  readonly nLate: number;
  readonly nDropped: number;
  readonly nClipped: number;
  readonly nJumps: number;
}

declare class Stylus {
  readonly stats: StylusStats;
  push(x: number, y: number, pressure: number, t: number): void;
  free(): void;
}

export type { Renderer, Stylus, Texture };
