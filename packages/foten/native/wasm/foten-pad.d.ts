/** A texture on a page: `<foten-pad src="denim.foten">`. Events: `ready` (detail: what the texture says of itself) and `refused` (a line). */
export declare class FotenPad extends HTMLElement {
  /** The surface: events in millimetres, drawn. `force`, 0 to 1, is that of a finger or the mouse. */
  readonly pad: { force: number; mmPerPx: number; setMmPerPx(mm: number): void };
  /** The sound: the kernel on the audio thread. */
  readonly sound: EventTarget & {
    readonly running: boolean;
    setVolume(db: number): void;
    route(deviceId: string, channel: number | null): Promise<void>;
    push(xMm: number, yMm: number, pressure: number, seconds: number): void;
  };
  /** Link of a texture file; another one is fetched, shown, and sounds where the one before did. */
  src: string | null;
  /** Begin to sound; to be called from a tap. */
  begin(): Promise<void>;
}

declare global {
  interface HTMLElementTagNameMap {
    "foten-pad": FotenPad;
  }
}
