// The cover from above: forward is up, each taxel where it is, coloured and labelled by its force.
import { STATUSES, type Picture } from "./picture";

const SVG = "http://www.w3.org/2000/svg";
const UNITS_PER_M = 100;
/** Force, N, and colour: red, green, blue. */
const COLOURS: [number, [number, number, number]][] =
  [[0, [232, 238, 240]], [2, [255, 224, 130]], [20, [251, 140, 0]], [60, [183, 28, 28]]];
/** From here on text on a taxel is white, N. */
const DARK_N = 40;

export function colour(force_n: number): string {
  const above = Math.max(1, COLOURS.findIndex(([n]) => force_n < n) === -1 ? COLOURS.length - 1 : COLOURS.findIndex(([n]) => force_n < n));
  const [[low, from], [high, to]] = [COLOURS[above - 1]!, COLOURS[above]!];
  const share = Math.min(1, Math.max(0, (force_n - low) / (high - low)));
  return `rgb(${from.map((c, i) => Math.round(c + share * (to[i]! - c))).join()})`;
}

function element(name: string, attributes: Record<string, string | number>, text = ""): SVGElement {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  made.textContent = text;
  return made;
}

interface Cell { box: SVGElement; force: SVGElement; name: SVGElement }

export class Cover {
  private cells: Cell[] = [];
  private most = element("text", {});
  private where = element("text", {});
  private shape = "";

  constructor(private svg: SVGSVGElement, private onPress: (taxel: number, pressed: boolean) => void) {}

  /** Draws the robot's outline again if it is another robot. */
  set(size: [number, number, number] | null, taxels: [number, number][] | null): void {
    const shape = JSON.stringify([size, taxels]);
    if (shape === this.shape || !size || !taxels) return;
    this.shape = shape;
    const [length, width] = [size[0] * UNITS_PER_M, size[1] * UNITS_PER_M];
    this.svg.setAttribute("viewBox", `${-width / 2 - 26} ${-length / 2 - 22} ${width + 52} ${length + 44}`);
    this.most = element("text", { y: 8, class: "most" });
    this.where = element("text", { y: 20, class: "quiet" });
    this.svg.replaceChildren(
      element("rect", { x: -width / 2, y: -length / 2, width, height: length, rx: 5, class: "body" }),
      element("path", { d: `M0 ${-length / 2 + 14} l8 12 h-16 z`, class: "ahead" }),
      this.most, this.where,
    );
    this.cells = taxels.map(([x, y], i) => this.cell(i, x, y, size));
  }

  private cell(i: number, x: number, y: number, size: [number, number, number]): Cell {
    const front = Math.abs(Math.abs(x) - size[0] / 2) < Math.abs(Math.abs(y) - size[1] / 2);
    const across = -y * UNITS_PER_M + (front ? 0 : Math.sign(-y) * 12);
    const down = -x * UNITS_PER_M + (front ? Math.sign(-x) * 10 : 0);
    const [width, height] = front ? [24, 18] : [22, 22];
    const group = element("g", { transform: `translate(${across} ${down})` });
    const box = element("rect", { x: -width / 2, y: -height / 2, width, height, rx: 3, class: "taxel" });
    const name = element("text", { y: -3.5, class: "name" }, `T${i + 1}`);
    const force = element("text", { y: 5, class: "force" });
    group.append(box, name, force);
    group.addEventListener("pointerdown", () => this.onPress(i, true));
    for (const end of ["pointerup", "pointercancel", "pointerleave"]) group.addEventListener(end, () => this.onPress(i, false));
    this.svg.append(group);
    return { box, name, force };
  }

  draw(picture: Picture): void {
    let [most, at] = [0, -1];
    this.cells.forEach(({ box, force, name }, i) => {
      const [status, n] = [picture.status[i] ?? 1, picture.force_n[i] ?? 0];
      const known = picture.live && status === 0;
      box.setAttribute("fill", known && n > 0 ? colour(n) : "");
      box.setAttribute("class", `taxel ${known ? (n > 0 ? "" : "rests") : "unknown"}`);
      force.textContent = known ? n.toFixed(n < 9.95 ? 1 : 0) : picture.live ? STATUSES[status] ?? "unknown" : "–";
      force.setAttribute("class", `force ${known ? "" : "word"}`);
      const tone = !known ? "onunknown" : n > DARK_N ? "ondark" : n > 0 ? "onlight" : "";
      for (const text of [force, name]) text.classList.remove("onunknown", "ondark", "onlight");
      if (tone) for (const text of [force, name]) text.classList.add(tone);
      if (known && n > most) [most, at] = [n, i];
    });
    this.most.textContent = picture.live ? `${most.toFixed(1)} N` : "–";
    this.where.textContent = !picture.live ? "not live" : at < 0 ? "no contact" : `largest, at T${at + 1}`;
  }
}
