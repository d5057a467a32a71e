// Calibration and parameters, for maintainers.
import type { Calibration, Link, State } from "./link";

interface Parameter {
  name: string; units: string[]; min: number; max: number; description: string; default: number[] | null; value: number[];
}

const PRESSES = 3;

function button(text: string, onclick: () => void): HTMLButtonElement {
  const made = document.createElement("button");
  [made.textContent, made.onclick] = [text, onclick];
  return made;
}

export function describe(c: Calibration | null): string {
  const taxel = `T${(c?.taxel ?? 0) + 1}`;
  switch (c?.step) {
    case "rest": return `${taxel}: nobody may touch the cover. ${c.done} of ${c.wanted} frames.`;
    case "press": return `${taxel}: press slowly and let go. ${c.done} of ${c.wanted} presses, gauge ${c.force_n ?? "–"} N.`;
    case "fitted": return `${taxel}: choose a model to save.`;
    case "saved": return `Saved in ${c.text}. Restart the daemon to use it.`;
    case "failed": case "unavailable": return c.text ?? c.step;
    default: return "Choose a taxel and press it with the force gauge.";
  }
}

export class Maintain {
  private shown = "";

  constructor(private status: HTMLElement, private row: HTMLElement, private list: HTMLElement, private link: () => Link | null) {}

  /** Shows what can be done now. */
  state(state: State): void {
    const { calibration, taxels } = state;
    this.status.textContent = describe(calibration);
    const shown = JSON.stringify([calibration?.step, calibration?.models, taxels?.length]);
    if (shown === this.shown) return;
    this.shown = shown;
    const cancel = button("Cancel", () => this.link()?.ask("cancel-calibration"));
    if (calibration?.step === "fitted") {
      const models = (calibration.models ?? []).map((model, i) => {
        const save = button(`Save ${model.name}: ${model.rmse_n.toFixed(2)} N rms, ${model.worst_n.toFixed(2)} N at most`,
          () => this.link()?.ask({ "save-calibration": { model: i } }));
        save.disabled = !model.usable;
        return save;
      });
      this.row.replaceChildren(...models, cancel);
    } else if (calibration?.step === "rest" || calibration?.step === "press") {
      this.row.replaceChildren(cancel);
    } else {
      this.row.replaceChildren(...(taxels ?? []).map((_, taxel) =>
        button(`T${taxel + 1}`, () => this.link()?.ask({ calibrate: { taxel, presses: PRESSES } }))));
    }
  }

  /** Lists the parameters that can be changed now. */
  async parameters(): Promise<void> {
    const answer = await fetch("/parameters").catch(() => null);
    if (!answer?.ok) { this.list.textContent = answer ? await answer.text() : "no link"; return; }
    const parameters = await answer.json() as Parameter[];
    this.list.replaceChildren(...parameters.map(parameter => this.entry(parameter)));
  }

  private entry(parameter: Parameter): HTMLElement {
    const [item, label, input, note] = ["li", "label", "input", "small"].map(name => document.createElement(name)) as
      [HTMLElement, HTMLElement, HTMLInputElement, HTMLElement];
    input.value = parameter.value.join(" ");
    input.inputMode = "decimal";
    const standard = parameter.default ? `, default ${parameter.default.join(" ")}` : "";
    note.textContent = `${parameter.description} ${parameter.min} to ${parameter.max} ${parameter.units.join(", ")}${standard}`;
    label.append(parameter.name, input);
    const set = button("Set", () => {
      const values = input.value.trim().split(/[\s,]+/).map(Number);
      this.link()?.ask({ "set-parameter": { name: parameter.name, values } });
    });
    item.append(label, set, note);
    return item;
  }
}
