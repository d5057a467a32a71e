// Largest force, speed and speed limit of the last seconds.
import uPlot from "uplot";
import "uplot/dist/uPlot.min.css";
import type { Picture } from "./picture";

const SECONDS = 20;
const POINTS_PER_S = 10;

export class Plot {
  private data: [number[], (number | null)[], (number | null)[], (number | null)[]] = [[], [], [], []];
  private plot: uPlot;

  constructor(private parent: HTMLElement) {
    const css = (name: string) => getComputedStyle(document.documentElement).getPropertyValue(name);
    const axis: uPlot.Axis = { stroke: () => css("--ink"), grid: { stroke: () => css("--line") }, font: "14px system-ui" };
    const upTo = (least: number) => (_: uPlot, __: number, most: number): [number, number] => [0, Math.max(least, most * 1.1)];
    this.plot = new uPlot({
      width: 300, height: 200, cursor: { show: false }, legend: { live: false },
      scales: { x: { time: false }, y: { range: upTo(10) }, v: { range: upTo(0.1) } },
      axes: [{ ...axis, label: "s" }, { ...axis, label: "N" }, { ...axis, scale: "v", side: 1, label: "m/s", grid: { show: false } }],
      series: [{}, { label: "largest force", stroke: "#e65100", width: 2 }, { label: "speed", scale: "v", stroke: "#1e88e5", width: 2 },
        { label: "speed limit", scale: "v", stroke: () => css("--quiet"), dash: [6, 4] }],
    }, this.data as uPlot.AlignedData, parent);
    new ResizeObserver(() => this.resize()).observe(parent);
    this.resize();
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.parent;
    if (width > 60 && height > 100) this.plot.setSize({ width, height: height - 40 });
  }

  add(picture: Picture): void {
    const [times] = this.data;
    const last = times[times.length - 1];
    if (last !== undefined && picture.time_s < last) for (const column of this.data) column.length = 0;
    if (last !== undefined && picture.time_s - last < 1 / POINTS_PER_S && picture.time_s >= last) return;
    const known = picture.force_n.filter((_, i) => picture.status[i] === 0);
    const shown = (value: number) => (picture.live ? value : null);
    times.push(picture.time_s);
    this.data[1].push(shown(Math.max(0, ...known)));
    this.data[2].push(shown(picture.speed));
    this.data[3].push(shown(picture.limit));
    while (times.length > SECONDS * POINTS_PER_S) for (const column of this.data) column.shift();
    if (this.parent.offsetParent) this.plot.setData(this.data as uPlot.AlignedData);
  }
}
