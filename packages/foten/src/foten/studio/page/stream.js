// Sound that a server renders, on the audio thread: it waits in a ring, and is played as it came.

const AHEAD_S = 0.02, BEHIND_S = 0.15; // of a stream that wait before it begins to play, and at most
const LINEAR = 0.8; // of full scale; beyond, what leaves is compressed and never reaches it

export class Stream {
  constructor(scale = 1) {
    Object.assign(this, { ring: new Float32Array(1 << 16), read: 0, written: 0, filling: true, lacking: 0, scale, speed: 0, force: 0 });
  }

  take({ samples, speed, force }) {
    const size = this.ring.length;
    for (let i = 0; i < samples.length; i++) this.ring[(this.written + i) % size] = samples[i];
    this.written += samples.length;
    if (this.written - this.read > BEHIND_S * sampleRate) this.read = this.written - AHEAD_S * sampleRate; // a pause of this page
    Object.assign(this, { speed, force });
  }

  /** Fill a quantum with the next samples, as they came. */
  fill(quantum) {
    const waits = this.written - this.read;
    if (this.filling && waits >= AHEAD_S * sampleRate) this.filling = false;
    quantum.fill(0);
    if (this.filling) return;
    const n = Math.min(quantum.length, waits);
    for (let i = 0; i < n; i++) quantum[i] = this.ring[(this.read + i) % this.ring.length];
    this.read += n;
    if (n < quantum.length) {
      this.filling = true;
      this.lacking++;
    }
  }
}

export function limited(sample) {
  const size = Math.abs(sample);
  if (size <= LINEAR) return sample;
  const room = 1 - LINEAR;
  return Math.sign(sample) * (LINEAR + room * Math.tanh((size - LINEAR) / room));
}
