// Hands on what an input hears, in pieces of `SAMPLES`, with the number of samples before each.

const SAMPLES = 896; // seven calls of 128: 19 ms at 48 kHz, and within a message to the server

class Input extends AudioWorkletProcessor {
  constructor() {
    super();
    this.piece = new Float32Array(SAMPLES);
    this.held = 0;
    this.next = null; // frame that has to come
  }

  process([[channel]]) {
    if (!channel) return true;
    if (this.next !== null && currentFrame !== this.next) this.port.postMessage({ missing: currentFrame - this.next });
    this.next = currentFrame + channel.length;
    for (let i = 0; i < channel.length; i++) {
      this.piece[this.held++] = channel[i];
      if (this.held < SAMPLES) continue;
      this.port.postMessage({ piece: this.piece }, [this.piece.buffer]);
      this.piece = new Float32Array(SAMPLES);
      this.held = 0;
    }
    return true;
  }
}

registerProcessor("foten-input", Input);
