// The picture of a texture, made from what the model renders: a relief with the spectrum that a tool meets on it, lit from the upper
// left; and how loud textures are to each other. Runs as a worker beside the page, since it takes some 100 ms.
import { Foten } from "./foten.mjs";

export const SIZE = 256; // pixels of a tile's side
export const TILE_MM = 24;
const SPEED = 80, FORCE = 0.8; // mm/s and N that the picture is of
const SEGMENT = 512; // samples of a spectrum
const TONE_DB = 11; // above what lies around it, a peak is a pattern of the surface
const MOST_TONES = 8;
const QUANTUM = 128, TIMED = 400; // samples; quanta that are timed
const LEVEL_SPEEDS = 9, LEVEL_FORCES = 6;

/** A complex transform in place, n a power of two. */
export function transform(re, im, inverse = false) {
  const n = re.length;
  for (let i = 1, j = 0; i < n; i++) {
    let bit = n >> 1;
    for (; j & bit; bit >>= 1) j ^= bit;
    j ^= bit;
    if (i < j) [re[i], re[j], im[i], im[j]] = [re[j], re[i], im[j], im[i]];
  }
  for (let size = 2; size <= n; size *= 2) {
    const angle = ((inverse ? 2 : -2) * Math.PI) / size;
    for (let k = 0; k < size / 2; k++) {
      const c = Math.cos(angle * k), s = Math.sin(angle * k);
      for (let i = k; i < n; i += size) {
        const j = i + size / 2, x = re[j] * c - im[j] * s, y = re[j] * s + im[j] * c;
        re[j] = re[i] - x;
        im[j] = im[i] - y;
        re[i] += x;
        im[i] += y;
      }
    }
  }
}

/** Welch's estimate of the power in each bin, with Hann's window and half of it in common. */
export function spectrum(samples) {
  const power = new Float64Array(SEGMENT / 2 + 1);
  let n = 0;
  for (let at = 0; at + SEGMENT <= samples.length; at += SEGMENT / 2, n++) {
    const re = new Float64Array(SEGMENT), im = new Float64Array(SEGMENT);
    for (let i = 0; i < SEGMENT; i++) re[i] = samples[at + i] * (0.5 - 0.5 * Math.cos((2 * Math.PI * i) / SEGMENT));
    transform(re, im);
    for (let k = 0; k < power.length; k++) power[k] += re[k] * re[k] + im[k] * im[k];
  }
  return power.map((sum) => sum / Math.max(1, n));
}

/** Part a spectrum into its peaks, [bin, power] each, and what lies around them. */
export function parted(power) {
  const around = power.map((_, k) => {
    const near = [...power.slice(Math.max(1, k - 10), k + 11)].sort((a, b) => a - b);
    return near[near.length >> 1] ?? 0;
  });
  const factor = 10 ** (TONE_DB / 10);
  const tones = [];
  for (let k = 2; k < power.length - 1; k++)
    if (power[k] > factor * around[k] && power[k] >= power[k - 1] && power[k] > power[k + 1]) tones.push([k, power[k]]);
  tones.sort((a, b) => b[1] - a[1]);
  return { tones: tones.slice(0, MOST_TONES), rest: power.map((value, k) => Math.min(value, factor * around[k])) };
}

function noise(seed) {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let t = Math.imul(state ^ (state >>> 15), 1 | state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

/** A relief that repeats at its edges, of unit slope: what is random in all directions alike, tones along both axes. */
export function relief(power, rate, speed, seed) {
  const { tones, rest } = parted(power), random = noise(seed), n = SIZE;
  const bin = (perMm) => (perMm * speed * SEGMENT) / rate;
  const heights = new Float64Array(n * n), zero = new Float64Array(n * n);
  for (let i = 0; i < n * n; i++) heights[i] = Math.sqrt(-2 * Math.log(1 - random())) * Math.cos(2 * Math.PI * random());
  across(heights, zero, false);
  let power1d = 0;
  for (let y = 0; y < n; y++)
    for (let x = 0; x < n; x++) {
      const perMm = Math.hypot(x < n / 2 ? x : x - n, y < n / 2 ? y : y - n) / TILE_MM, k = bin(perMm);
      const at = Math.min(rest.length - 1, k), low = Math.floor(at), high = Math.min(rest.length - 1, low + 1);
      const value = k < rest.length - 1 && perMm > 0 ? rest[low] + (at - low) * (rest[high] - rest[low]) : 0;
      // A line of the plane has the power of all rings that cross it: over its frequency. And a slope is what is seen.
      const gain = Math.sqrt(value / Math.max(perMm, 0.2)) / Math.max(perMm, 0.2);
      heights[y * n + x] *= gain;
      zero[y * n + x] *= gain;
    }
  across(heights, zero, true);
  for (const value of rest) power1d += value;
  const unit = 1 / (deviation(heights) || 1);
  for (let i = 0; i < n * n; i++) heights[i] *= unit;
  const random_ = slope(heights) || 1;
  for (const [k, value] of tones) {
    const turns = Math.max(1, Math.round(((k * rate) / SEGMENT / speed) * TILE_MM));
    if (turns > n / 4) continue;
    const phase = 2 * Math.PI * random(), size = (random_ * 0.9 * Math.sqrt((20 * value) / (power1d || 1)) * n) / (2 * Math.PI * turns);
    for (let y = 0; y < n; y++)
      for (let x = 0; x < n; x++)
        heights[y * n + x] += size * (Math.cos((2 * Math.PI * turns * x) / n + phase) + Math.cos((2 * Math.PI * turns * y) / n + phase));
  }
  const steep = slope(heights) || 1;
  return heights.map((height) => height / steep);
}

function across(re, im, inverse) {
  const n = SIZE, a = new Float64Array(n), b = new Float64Array(n);
  for (let y = 0; y < n; y++) {
    const row = re.subarray(y * n, y * n + n), other = im.subarray(y * n, y * n + n);
    transform(row, other, inverse);
  }
  for (let x = 0; x < n; x++) {
    for (let y = 0; y < n; y++) [a[y], b[y]] = [re[y * n + x], im[y * n + x]];
    transform(a, b, inverse);
    for (let y = 0; y < n; y++) [re[y * n + x], im[y * n + x]] = [a[y], b[y]];
  }
}

const deviation = (values) => Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length);

function slope(heights) {
  const n = SIZE;
  let sum = 0;
  for (let y = 0; y < n; y++)
    for (let x = 0; x < n; x++) {
      const dx = heights[y * n + ((x + 1) % n)] - heights[y * n + x], dy = heights[((y + 1) % n) * n + x] - heights[y * n + x];
      sum += dx * dx + dy * dy;
    }
  return Math.sqrt(sum / (n * n));
}

// What materials look like; others take one of these by their name.
const COLOURS = {
  steel: [215, 9, 52], metal: [215, 9, 52], aluminium: [215, 8, 58], copper: [20, 45, 46], plastic: [205, 18, 56], rubber: [240, 6, 30],
  grass: [96, 26, 38], wood: [29, 34, 44], cardboard: [32, 30, 52], cork: [28, 36, 48], leather: [18, 34, 34], paper: [42, 18, 74],
  denim: [216, 34, 40], jeans: [216, 34, 40], cloth: [36, 16, 60], fabric: [350, 16, 54], towel: [40, 20, 72], felt: [160, 14, 40],
  styrofoam: [205, 12, 76], foam: [205, 12, 76], sand: [36, 32, 58], stone: [30, 7, 50], glass: [190, 16, 62], ceramic: [200, 10, 66],
};

/** Return hue, saturation and lightness for a name. */
export function colour(name) {
  const word = Object.keys(COLOURS).find((one) => name.toLowerCase().includes(one));
  if (word) return COLOURS[word];
  let hash = 7;
  for (const letter of name) hash = (hash * 31 + letter.charCodeAt(0)) >>> 0;
  return [hash % 360, 14 + (hash % 13), 42 + (hash % 17)];
}

/** Light a relief: pixels, RGBA. `roughAt(x, y)` is the slope's size there. */
export function lit(heights, [hue, saturation, lightness], roughAt) {
  const n = SIZE, pixels = new Uint8ClampedArray(4 * n * n), light = [-0.5, -0.58, 0.64];
  for (let y = 0; y < n; y++)
    for (let x = 0; x < n; x++) {
      const i = y * n + x, rough = roughAt(x, y), dx = (heights[y * n + ((x + 1) % n)] - heights[i]) * rough, dy = (heights[((y + 1) % n) * n + x] - heights[i]) * rough;
      const towards = (-dx * light[0] - dy * light[1] + light[2]) / Math.hypot(dx, dy, 1);
      const bright = Math.max(0.04, Math.min(0.97, (lightness / 100) * (0.42 + 0.9 * towards)));
      const [r, g, b] = rgb(hue, saturation / 100, bright);
      pixels.set([r, g, b, 255], 4 * i);
    }
  return pixels;
}

function rgb(hue, saturation, lightness) {
  const a = saturation * Math.min(lightness, 1 - lightness);
  return [0, 8, 4].map((offset) => {
    const k = (offset + hue / 30) % 12;
    return 255 * (lightness - a * Math.max(-1, Math.min(k - 3, 9 - k, 1)));
  });
}

const rms = (samples) => Math.sqrt(samples.reduce((sum, value) => sum + value * value, 0) / samples.length);
const within = (value, [low, high]) => Math.min(high, Math.max(low, value));

/** Return the median and 99 % of how long the kernel takes for what an audio thread asks for at once [ms]. */
function timed(texture, speed, force) {
  const renderer = texture.renderer({ rate: 48000 }), out = new Float32Array(QUANTUM), took = [];
  renderer.setCondition(speed, force);
  for (let i = 0; i < TIMED; i++) {
    const begin = performance.now();
    renderer.render(out);
    took.push(performance.now() - begin);
  }
  renderer.free();
  took.sort((a, b) => a - b);
  return [took[TIMED >> 1], took[Math.floor(0.99 * TIMED)]];
}

const roughness = (loud) => within(0.22 + 0.3 * Math.log10(1 + 4 * loud), [0.2, 0.95]);

/** Return the level over speed and force: RMS at `LEVEL_SPEEDS` × `LEVEL_FORCES` conditions, evenly over the range that was recorded. */
function levelsOf(texture, of) {
  const { rate, trainedSpeed, trainedForce } = texture.info;
  const along = ([low, high], n) => Array.from({ length: n }, (_, i) => low + ((high - low) * (i + 0.5)) / n);
  return along(trainedForce, LEVEL_FORCES).map((f) => along(trainedSpeed, LEVEL_SPEEDS).map((v) => rms(of(v, f, Math.round(0.15 * rate)))));
}

/** Return the value of a map at shares of its axes, between its points. */
function between(map, across, up) {
  const at = (share, n) => Math.min(n - 1.001, Math.max(0, share * n - 0.5));
  const y = at(up, map.length), x = at(across, map[0].length), j = Math.floor(y), i = Math.floor(x);
  const row = (r) => map[r][i] + (x - i) * (map[r][i + 1] - map[r][i]);
  return row(j) + (y - j) * (row(j + 1) - row(j));
}

/** Return a texture's pictures, from the bytes of its file: a tile for the surface, and a swatch, as rough as it is from slow (left) to
 * fast (right) and from light (below) to firm (above). */
export function pictured(foten, bytes, name) {
  const texture = foten.texture(bytes), { rate, trainedSpeed, trainedForce } = texture.info;
  const renderer = texture.renderer({ seed: 1 });
  try {
    const speed = within(SPEED, trainedSpeed), force = within(FORCE, trainedForce);
    const of = (v, f, n) => {
      renderer.reset();
      renderer.setCondition(v, f);
      return renderer.render(new Float32Array(n));
    };
    const shown = of(speed, force, Math.max(8 * SEGMENT, Math.round(2 * rate))), levels = levelsOf(texture, of);
    const seed = [...name].reduce((sum, letter) => (sum * 33 + letter.charCodeAt(0)) >>> 0, 5);
    const heights = relief(spectrum(shown), rate, speed, seed), rough = roughness(rms(shown)), hue = colour(name);
    return {
      pixels: lit(heights, hue, () => rough),
      swatch: lit(heights, hue, (x, y) => roughness(between(levels, x / SIZE, 1 - y / SIZE))),
      size: SIZE,
      mm: TILE_MM,
      took: timed(texture, speed, force),
    };
  } finally {
    renderer.free();
    texture.free();
  }
}

// As the server has it, `levels.py`.
const SETTLE_S = 0.5, LEVEL_S = 1, SHARES = [0.25, 0.5, 0.75], MOST_DB = 30;

/** Return dB that make methods of one texture equally loud, from the bytes of their files. */
export function gainsOf(foten, files) {
  const textures = files.map((bytes) => foten.texture(bytes));
  try {
    const common = (name) => {
      const low = Math.max(...textures.map(({ info }) => info[name][0])), high = Math.min(...textures.map(({ info }) => info[name][1]));
      return SHARES.map((share) => low + share * Math.max(0, high - low));
    };
    const conditions = common("trainedSpeed").flatMap((v) => common("trainedForce").map((f) => [v, f]));
    const levels = textures.map((texture) => {
      const { rate, accelerationSd } = texture.info, settle = Math.round(SETTLE_S * rate), renderer = texture.renderer({ seed: 1 });
      let power = 0;
      for (const [v, f] of conditions) {
        renderer.reset(1);
        renderer.setCondition(v, f);
        power += rms(renderer.render(new Float32Array(settle + Math.round(LEVEL_S * rate))).subarray(settle)) ** 2 / conditions.length;
      }
      renderer.free();
      return 10 * Math.log10(Math.max(1e-30, power / accelerationSd ** 2));
    });
    const sorted = [...levels].sort((a, b) => a - b), usual = (sorted[(sorted.length - 1) >> 1] + sorted[sorted.length >> 1]) / 2;
    return levels.map((level) => within(usual - level, [-MOST_DB, MOST_DB]));
  } finally {
    for (const texture of textures) texture.free();
  }
}

if (typeof WorkerGlobalScope !== "undefined" && self instanceof WorkerGlobalScope) {
  const kernel = fetch(new URL("foten.wasm", import.meta.url)).then((answer) => answer.arrayBuffer()).then((bytes) => Foten.load(bytes));
  const jobs = { picture: (foten, { bytes, name }) => pictured(foten, bytes[0], name), gains: (foten, { bytes }) => gainsOf(foten, bytes) };
  self.onmessage = async ({ data }) => {
    try {
      self.postMessage({ job: data.job, answer: jobs[data.do](await kernel, data) });
    } catch (error) {
      self.postMessage({ job: data.job, failed: error.message });
    }
  };
}
