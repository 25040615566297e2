// Textures: those that the page comes with, and files that were opened. A card is read without the kernel.

/** Return the card in the bytes of a texture file. Throws a line for people where there is none. */
export function cardOf(bytes) {
  const refuse = (why) => new Error(`this is not a texture file: ${why}`);
  if (bytes.byteLength < 8) throw refuse(`it has ${bytes.byteLength} bytes`);
  if (new Uint8Array(bytes, 1, 3).every((byte, i) => byte === "HDF".charCodeAt(i))) throw refuse("it is HDF5, as a recording is; foten train learns a texture from it");
  const length = Number(new DataView(bytes).getBigUint64(0, true));
  if (length > bytes.byteLength - 8 || length > 100e6) throw refuse("it is truncated, or of another kind");
  try {
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(bytes, 8, length)));
    const card = JSON.parse(header.__metadata__.foten);
    return { ...card, hasGraph: "graph" in header };
  } catch {
    throw refuse("there is no card in it");
  }
}

/** Return a texture's name as people write it: `steel-mesh-1` → `Steel mesh 1`. */
export function titled(name) {
  const words = name.replaceAll(/[-_]+/g, " ").trim();
  return words ? words[0].toUpperCase() + words.slice(1) : "Texture";
}

export class Texture {
  constructor({ file, name, method, picture = null, relative = false, bytes = null }) {
    const photo = picture && picture.split("/").map(encodeURIComponent).join("/"); // a name may hold # or ?
    Object.assign(this, { file, name, method, photo, relative });
    this.id = file;
    this.held = bytes && Promise.resolve(bytes);
  }

  /** Return the bytes of the file, fetched once. */
  get bytes() {
    this.held ??= fetch(`textures/${encodeURIComponent(this.file)}`).then(async (answer) => {
      if (!answer.ok) throw new Error(`${this.file} could not be fetched: ${answer.status} ${answer.statusText}`);
      return answer.arrayBuffer();
    });
    return this.held;
  }

  get title() {
    return titled(this.name || this.file.replace(/\.foten$/, ""));
  }
}

/** Return the textures that come with the page, whether its server can render them, and why that cannot train, if it cannot. */
export async function shipped() {
  const answer = await fetch("textures.json");
  if (!answer.ok) throw new Error(`the list of textures could not be fetched: ${answer.status}`);
  const { textures, server, cannot_train } = await answer.json();
  return { textures: textures.map((one) => new Texture(one)), server: Boolean(server), cannotTrain: cannot_train || "" };
}

let opened = 0;

/** Return a texture of a file that was dropped or opened. */
export async function textureOf(file) {
  const bytes = await file.arrayBuffer();
  const card = cardOf(bytes);
  const texture = new Texture({ file: file.name, name: card.texture, method: card.model, relative: card.units?.acceleration === "relative", bytes });
  texture.id = `${file.name}#${++opened}`;
  texture.card = card;
  return texture;
}

/** Return textures by what they are of, each with its methods. */
export function grouped(textures) {
  const groups = new Map();
  for (const one of textures) {
    const key = one.title.toLowerCase();
    if (!groups.has(key)) groups.set(key, []);
    groups.get(key).push(one);
  }
  return [...groups.values()];
}
