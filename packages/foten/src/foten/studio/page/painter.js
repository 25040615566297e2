// What surface.js makes of texture files, in a worker of its own.

let worker = null, jobs = 0;
const waiting = new Map();

/** Return what the worker makes of texture files; reject with a line for people. */
export function asked(message) {
  if (!worker) {
    worker = new Worker(new URL("surface.js", import.meta.url), { type: "module" });
    worker.onmessage = ({ data: { job, answer, failed } }) => {
      const { resolve, reject } = waiting.get(job);
      waiting.delete(job);
      if (failed) reject(new Error(failed));
      else resolve(answer);
    };
    worker.onerror = () => {
      for (const { reject } of waiting.values()) reject(new Error("the picture's worker did not start: surface.js has to be beside painter.js"));
      waiting.clear();
      worker = null;
    };
  }
  return new Promise((resolve, reject) => (waiting.set(++jobs, { resolve, reject }), worker.postMessage({ job: jobs, ...message })));
}

/** Return the picture of a texture file's bytes: a tile on a canvas, its width in mm, and a swatch as a link. */
export async function painted(bytes, name) {
  const picture = await asked({ do: "picture", bytes: [bytes], name });
  const drawn = (pixels) => {
    const canvas = Object.assign(document.createElement("canvas"), { width: picture.size, height: picture.size });
    canvas.getContext("2d").putImageData(new ImageData(pixels, picture.size, picture.size), 0, 0);
    return canvas;
  };
  return { ...picture, canvas: drawn(picture.pixels), url: drawn(picture.swatch).toDataURL("image/jpeg", 0.85) };
}
