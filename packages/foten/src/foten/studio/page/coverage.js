// Which speeds and forces were stroked already, as a field that fills; and where to stroke next.

const SPEEDS = [15, 45, 80, 130, 260]; // mm/s, edges of the columns
const FORCES = [0.1, 0.45, 1.0, 3.0]; // N, of the rows
const ENOUGH_S = 1.6; // in each cell
const PATIENCE_S = 5; // of strokes, after which another cell is asked for
const SMOOTHED_S = 0.06; // of what is called speed and force here

export class Coverage {
  constructor(canvas) {
    this.canvas = canvas;
    this.start(true);
  }

  /** Begin anew; without pressure there is one row. */
  start(pressure) {
    this.rows = pressure ? FORCES.length - 1 : 1;
    this.cells = Array.from({ length: this.rows }, () => new Float64Array(SPEEDS.length - 1));
    this.now = null; // speed [mm/s] and force [N]
    this.last = null;
    this.stroked = 0;
    this.target = null;
    this.draw();
  }

  get enough() {
    return this.rows > 1 ? ENOUGH_S : 2.5 * ENOUGH_S;
  }

  /** Take in an event: position [mm], force [N], 0 for lifted, time [s]. */
  take(x, y, force, t) {
    const { last } = this;
    this.last = force > 0 ? { x, y, t } : null;
    if (!(force > 0)) return (this.now = null);
    if (!last || t <= last.t || t - last.t > 0.1) return;
    const dt = t - last.t, speed = Math.hypot(x - last.x, y - last.y) / dt, share = 1 - Math.exp(-dt / SMOOTHED_S);
    this.now ??= { speed, force };
    this.now.speed += share * (speed - this.now.speed);
    this.now.force += share * (force - this.now.force);
    const [row, column] = this.cellOf(this.now);
    if (this.now.speed >= SPEEDS[0] / 2) {
      this.stroked += dt;
      this.cells[row][column] += dt;
    }
  }

  cellOf({ speed, force }) {
    const of = (value, edges) => Math.max(0, Math.min(edges.length - 2, edges.findLastIndex((edge) => value >= edge)));
    return [this.rows > 1 ? of(force, FORCES) : 0, of(speed, SPEEDS)];
  }

  share(row, column) {
    return Math.min(1, this.cells[row][column] / this.enough);
  }

  get done() {
    const shares = this.cells.flatMap((row, r) => [...row.keys()].map((c) => this.share(r, c)));
    return shares.reduce((sum, one) => sum + one, 0) / shares.length;
  }

  /** The cell to stroke next: what lacks most, the nearest of those to the hand; it stays for a while. */
  get next() {
    const { target } = this, [row, column] = this.now ? this.cellOf(this.now) : [0, 1];
    if (target && this.share(target.row, target.column) < 1 && this.stroked - target.since < PATIENCE_S) return target;
    let best = null;
    this.cells.forEach((cells, r) =>
      cells.forEach((_, c) => {
        const lack = 1 - this.share(r, c), cost = 0.12 * (Math.abs(r - row) + Math.abs(c - column));
        if (lack > 0 && (!best || lack - cost > best.value)) best = { value: lack - cost, row: r, column: c, since: this.stroked };
      }),
    );
    return (this.target = best);
  }

  /** What to do, in one or two words. */
  get advice() {
    const { next } = this;
    if (!next) return "";
    if (!this.now) return "Stroke";
    const [row, column] = this.cellOf(this.now);
    const words = [column < next.column ? "faster" : column > next.column ? "slower" : "", row < next.row ? "harder" : row > next.row ? "lighter" : ""];
    const said = words.filter(Boolean).join(", ") || "go on";
    return said[0].toUpperCase() + said.slice(1);
  }

  draw() {
    const { canvas } = this, ratio = devicePixelRatio, [w, h] = [canvas.clientWidth, canvas.clientHeight];
    if (!w) return;
    const size = [Math.round(w * ratio), Math.round(h * ratio)];
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    const g = canvas.getContext("2d"), style = getComputedStyle(canvas), columns = SPEEDS.length - 1, gap = 5, next = this.next;
    g.setTransform(ratio, 0, 0, ratio, 0, 0);
    g.clearRect(0, 0, w, h);
    const cw = (w + gap) / columns, ch = (h + gap) / this.rows;
    for (let r = 0; r < this.rows; r++)
      for (let c = 0; c < columns; c++) {
        const x = c * cw, y = h - (r + 1) * ch + gap, share = this.share(r, c);
        g.beginPath();
        g.roundRect(x, y, cw - gap, ch - gap, 8);
        g.fillStyle = style.borderTopColor;
        g.fill();
        g.save();
        g.clip();
        g.fillStyle = style.color;
        g.fillRect(x, y + (1 - share) * (ch - gap), cw, share * (ch - gap));
        g.restore();
        g.lineWidth = 1;
        g.globalAlpha = 0.3; // a line about each, for a dark ground hardly differs from a cell
        g.strokeStyle = style.outlineColor;
        g.stroke();
        g.globalAlpha = 1;
        if (next?.row === r && next?.column === c) {
          g.lineWidth = 3;
          g.strokeStyle = style.outlineColor;
          g.beginPath();
          g.roundRect(x + 2, y + 2, cw - gap - 4, ch - gap - 4, 7);
          g.stroke();
        }
      }
    if (!this.now) return;
    const along = (value, edges) => {
      const i = Math.max(0, Math.min(edges.length - 2, edges.findLastIndex((edge) => value >= edge)));
      return (i + Math.max(0, Math.min(1, (value - edges[i]) / (edges[i + 1] - edges[i])))) / (edges.length - 1);
    };
    g.beginPath();
    g.arc(w * along(this.now.speed, SPEEDS), this.rows > 1 ? h * (1 - along(this.now.force, FORCES)) : h / 2, 7, 0, 7);
    g.fillStyle = style.outlineColor;
    g.fill();
  }
}
