// The gripper: its state, and requests for a thumb. Nothing that is held opens by one press.
import type { Link, State } from "./link";
import { PHASES, type Picture } from "./picture";

/** Speed, m/s, and tolerance, m, of each grasp. */
const [SPEED_M_S, TOLERANCE_M] = [0.05, 0.005];
/** A second press that comes sooner is the same press, and one that comes later asks again, ms. */
const [SOONEST_MS, LATEST_MS] = [400, 4000];
const [HOLDING, UNKNOWN] = [PHASES.indexOf("holding"), PHASES.indexOf("unknown")];

/** A number of a grasp: its slider, what it begins with, its unit and how many of that are an SI unit. */
interface Slider { input: HTMLInputElement; range: "width_m" | "force_n" | "mass_kg"; first: number; unit: string; scale: number }

export class Gripper {
  private picture: Picture | null = null;
  /** When the question whether to let go was put, ms; 0 without one. */
  private asked = 0;
  private sliders: Slider[];

  constructor(private section: HTMLElement, private link: () => Link | null) {
    const slider = (id: string, range: Slider["range"], first: number, unit: string, scale: number): Slider =>
      ({ input: this.get(id), range, first, unit, scale });
    this.sliders = [slider("width", "width_m", 50, "mm", 1e3), slider("force", "force_n", 40, "N", 1),
      slider("mass", "mass_kg", 0, "kg", 1)];
    for (const slider of this.sliders) slider.input.oninput = () => this.label(slider);
    this.get("release").onclick = () => this.release(performance.now());
    this.get("halt").onclick = () => this.link()?.ask({ gripper: "Stop" });
    this.get("grasp").onclick = () => this.grasp();
  }

  private get<E extends HTMLElement>(id: string): E { return this.section.querySelector<E>(`#${id}`)!; }

  private label({ input, unit, range }: Slider): void {
    const untold = range === "mass_kg" && Number(input.value) === 0;
    input.parentElement!.querySelector("output")!.textContent = untold ? "not told" : `${input.value} ${unit}`;
  }

  /** Ranges, and whether this page may ask. */
  state({ gripper }: State, may: boolean): void {
    for (const button of this.section.querySelectorAll("button")) button.disabled = !may || !gripper;
    if (!gripper) return;
    for (const slider of this.sliders) {
      const { input, range, first, scale } = slider;
      const [min, max] = gripper[range].map(bound => String(bound * scale)) as [string, string];
      if (input.min === min && input.max === max) continue;
      [input.min, input.max] = [min, max];
      input.value = localStorage.getItem(range) ?? String(first);
      this.label(slider);
    }
  }

  draw(picture: Picture): void {
    this.picture = picture;
    const { live, gripper } = picture;
    const phase = gripper?.phase ?? UNKNOWN;
    const mass = gripper && gripper.object_kg > 0 ? `${gripper.object_kg.toFixed(2)} kg carried` : "mass not told";
    const object = phase === HOLDING ? ` · ${mass}` : "";
    const text = !live || !gripper ? "–" : phase === UNKNOWN ? "no answer from the gripper"
      : `${PHASES[phase]} · ${(gripper.width_m * 1e3).toFixed(1)} mm${object}`;
    const shown = this.get("fingers");
    if (shown.textContent !== text) shown.textContent = text;
    if (this.asked && (!this.mayHold() || performance.now() - this.asked > LATEST_MS)) this.ask(0);
  }

  /** True unless a picture shows that nothing is held. */
  private mayHold(): boolean {
    const phase = this.picture?.live ? this.picture.gripper?.phase : UNKNOWN;
    return phase === undefined || phase === HOLDING || phase === UNKNOWN;
  }

  private ask(at: number): void {
    this.asked = at;
    const release = this.get("release");
    release.classList.toggle("next", at > 0);
    release.querySelector("small")!.textContent = at ? "An object may fall: press again" : "";
  }

  private release(now: number): void {
    const since = now - this.asked;
    if (this.mayHold() && !(this.asked && since <= LATEST_MS)) return this.ask(now);
    if (this.asked && since < SOONEST_MS) return;
    this.ask(0);
    this.link()?.ask({ gripper: "Release" });
  }

  private grasp(): void {
    const [width_m, force_n, mass_kg] = this.sliders.map(({ input, range, scale }) => {
      localStorage.setItem(range, input.value);
      return Number(input.value) / scale;
    }) as [number, number, number];
    this.link()?.ask({ gripper: { Grasp: { width_m, speed_m_s: SPEED_M_S, force_n, tolerance_m: TOLERANCE_M, mass_kg } } });
  }
}
