import "./style.css";
import { Cover } from "./cover";
import { Gripper } from "./gripper";
import { holdToRun } from "./hold";
import { Link, type Reply, type State } from "./link";
import { Maintain } from "./maintain";
import { MODES, REASONS, type Picture } from "./picture";
import type { Plot } from "./plot";
import type { Robot } from "./robot";

/** Nothing older is shown as live, ms. */
const STALE_MS = 200;
/** A stop that is not confirmed after so long is reported, ms. */
const STOP_MS = 600;
/** How often other robots are looked at, ms. */
const OTHERS_MS = 1000;
const STOPPED = MODES.indexOf("protective stop");

const $ = <E extends HTMLElement>(id: string) => document.getElementById(id) as E;
const all = <E extends HTMLElement>(selector: string) => [...document.querySelectorAll<E>(selector)];
/** Two digits, without a minus sign before zero. */
const rounded = (value: number) => (Math.round(value * 100) / 100 + 0).toFixed(2);
const put = (element: Element | undefined, text: string) => { if (element && element.textContent !== text) element.textContent = text; };

let link: Link | null = null;
let state: State | null = null;
let plot: Plot | null = null;
let robot: Robot | null = null;
/** The robot has run since the present press began. */
let ran = false;
let stopping: { stop: number; at: number } | null = null;
let shown = 0;

// Light and dark.
const root = document.documentElement;
const dark = matchMedia("(prefers-color-scheme: dark)").matches;
root.dataset["theme"] = localStorage.getItem("theme") ?? (dark ? "dark" : "light");
$("theme").onclick = () => {
  const other = root.dataset["theme"] === "dark" ? "light" : "dark";
  localStorage.setItem("theme", root.dataset["theme"] = other);
};

// Pages.
const maintain = new Maintain($("calibration"), $("calibrate"), $("parameters"), () => link);
for (const to of all("[data-to]")) to.onclick = () => open(to.dataset["to"]!);
addEventListener("resize", load);

function open(page: string): void {
  document.body.dataset["page"] = page;
  for (const to of all("[data-to]")) to.toggleAttribute("aria-current", to.dataset["to"] === page);
  if (page === "logs") void logs();
  if (page === "robots") void others();
  if (page === "maintain") void maintain.parameters();
  load();
}

/** Loads a part of the page once it is visible: what is needed to stop the robot comes first. */
function load(): void {
  if (!plot && $("plot").offsetParent) import("./plot").then(m => (plot ??= new m.Plot($("plot"))), () => toast("The plot cannot be loaded.", true));
  if (!robot && $("robot").offsetParent) {
    import("./robot").then(m => m.Robot.load($("view"))).then(made => (robot ??= made), () => toast("This device shows no 3-D.", true));
  }
}

async function logs(): Promise<void> {
  const answer = await fetch("/logs").catch(() => null);
  if (!answer?.ok) return put($("loglist"), answer ? await answer.text() : "no link");
  const list = await answer.json() as { name: string; bytes: number }[];
  $("loglist").replaceChildren(...list.reverse().map(({ name, bytes }) => {
    const [item, anchor] = [document.createElement("li"), document.createElement("a")];
    [anchor.href, anchor.download] = [`/logs/${encodeURIComponent(name)}`, name];
    anchor.textContent = `${name} · ${(bytes / 1e6).toFixed(1)} MB`;
    item.append(anchor);
    return item;
  }));
  if (!list.length) put($("loglist"), "No logs yet.");
}

interface Other {
  name: string; page: string | null; away: string | null; mode: string | null; fault: string | null; force_n: number; taxels_ok: number;
  taxels: number; cover_age_s: number;
}

/** Lists the other robots, and again while the page shows them. */
async function others(): Promise<void> {
  const answer = await fetch("/robots").catch(() => null);
  const list = answer?.ok ? await answer.json() as Other[] : [];
  for (const to of all("[data-to=robots]")) to.hidden = !list.length;
  $("robotlist").replaceChildren(...list.map(other => {
    const [item, name, mode, cover, more] = ["li", other.page ? "a" : "strong", "span", "span", "small"]
      .map(tag => document.createElement(tag)) as [HTMLElement, HTMLElement, HTMLElement, HTMLElement, HTMLElement];
    if (name instanceof HTMLAnchorElement) name.href = other.page!;
    name.textContent = other.name;
    mode.textContent = other.mode ?? "away";
    mode.className = `chip ${other.away || other.fault ? "stopped" : other.mode === "impedance" || other.mode === "follow-me" ? "moves" : "rests"}`;
    if (!other.away) cover.textContent = `${other.force_n.toFixed(1)} N, ${other.taxels_ok} of ${other.taxels} taxels`;
    const age = other.cover_age_s < 0 ? "no cover data yet" : `cover data ${(other.cover_age_s * 1e3).toFixed(0)} ms old`;
    more.textContent = other.away ?? (other.fault ? `${other.fault} ${age}` : age);
    item.append(name, mode, cover, more);
    return item;
  }));
  if (document.body.dataset["page"] === "robots") setTimeout(() => void others(), OTHERS_MS);
}

let toastEnds = 0;
function toast(text: string, bad = false): void {
  put($("toast"), text);
  $("toast").className = bad ? "bad" : "";
  $("toast").hidden = false;
  clearTimeout(toastEnds);
  toastEnds = window.setTimeout(() => ($("toast").hidden = true), bad ? 6000 : 2500);
}

// State.
const cover = new Cover($("ring") as unknown as SVGSVGElement, (taxel, pressed) => {
  if (state?.simulated && state.role !== "viewer") link?.ask({ "press-taxel": { taxel, force_n: pressed ? 20 : 0 } });
});
const values = Object.fromEntries(["Place", "Heading", "Speed", "Limit", "Cover data", "Cover rate"].map(name => {
  const [group, term, value] = ["div", "dt", "dd"].map(tag => document.createElement(tag)) as [HTMLElement, HTMLElement, HTMLElement];
  term.textContent = name;
  group.append(term, value);
  $("values").append(group);
  return [name, value];
}));

const gripper = new Gripper($("gripper"), () => link);

function see(next: State): void {
  state = next;
  const down = next.down !== null;
  put($("name"), next.name ?? "robot");
  put($("who"), next.holder ? `${next.holder} commands` : `${next.you} · ${next.role}`);
  put($("mode"), down ? "no daemon" : next.mode);
  $("mode").className = `chip ${down || next.fault ? "stopped" : next.moves ? "moves" : "rests"}`;
  // A gripper's fault stops nothing, and is seen from every page all the same.
  const fault = next.fault ?? next.gripper?.fault;
  const text = next.down ?? (fault ? `${fault.text} ${fault.remedy}` : next.notice || next.uncalibrated || "");
  put($("fault"), text);
  $("fault").hidden = !text;
  $("fault").className = down || fault ? "bad" : "";
  document.body.classList.toggle("running", next.moves && !down);
  cover.set(next.size, next.taxels);
  maintain.state(next);
  buttons(next, down);
  // The robot has stopped by itself: only a new press goes on.
  if (link?.press && next.moves) ran = true;
  else if (link?.press && ran) end();
}

function buttons(next: State, down: boolean): void {
  const may = next.role !== "viewer" && !down;
  const ours = next.holder === null || next.holder === next.you;
  const rests = next.mode === "ready" || next.mode === "protective stop" || next.mode === "starting";
  $<HTMLButtonElement>("tare").disabled = !may || !ours || !rests;
  $<HTMLButtonElement>("resume").disabled = !may || !ours || next.mode !== "protective stop";
  $("resume").classList.toggle("next", may && next.mode === "protective stop");
  for (const law of all<HTMLButtonElement>("[data-law]")) {
    law.disabled = !may || !ours;
    law.setAttribute("aria-pressed", String(law.dataset["law"] === next.law));
  }
  for (const to of all("[data-to=gripper]")) to.hidden = !next.gripper;
  gripper.state(next, may && ours);
  for (const to of all("[data-to=maintain]")) to.hidden = next.role !== "maintainer";
  const runs = may && ours && (next.mode === "ready" || next.moves);
  $<HTMLButtonElement>("run").disabled = !runs;
  put($("runtext"), next.role === "viewer" ? "this device watches and stops" : down ? "no daemon"
    : !ours ? `${next.holder} commands` : next.moves && link?.press ? "running: let go to end"
    : next.mode === "ready" ? `${next.law ?? ""} while you hold` : `not in ${next.mode}`);
}

function answer({ ok, what, text }: Reply): void {
  if (ok) return;
  if (what === "run") end();
  toast(text ?? `${what} was refused`, true);
}

// Drawing: a sign of life follows each picture that was drawn, and nothing else.
function draw(now: number): void {
  requestAnimationFrame(draw);
  const picture = link?.picture;
  const old = !link || !picture || !link.open || now - link.arrived > STALE_MS;
  document.body.classList.toggle("stale", old || !picture?.live);
  $("lost").hidden = !old || now - (link?.arrived ?? now) < 2 * STALE_MS || !$("pair").hidden;
  watchStop(now, picture);
  if (!link || !picture || old) {
    if (shown >= 0 && picture) show({ ...picture, live: false });
    put($("age"), "no link");
    $("age").className = "chip stopped";
    shown = -1;
    // A press stays: a short stall is no release, and after a long one the gateway has stopped the robot.
    return;
  }
  if (picture.number !== shown) {
    shown = picture.number;
    show(picture);
    plot?.add(picture);
    if (robot && $("robot").offsetParent) robot.draw(picture);
    link.drawn = picture.number;
  }
  link.beat(now);
}

function show(picture: Picture): void {
  const live = (text: string) => (picture.live ? text : "–");
  const [x = 0, y = 0, yaw = 0] = picture.pose;
  cover.draw(picture);
  gripper.draw(picture);
  put(values["Place"], live(`${rounded(x)}, ${rounded(y)} m`));
  put(values["Heading"], live(`${(yaw * 180 / Math.PI).toFixed(0)}°`));
  put(values["Speed"], live(`${picture.speed.toFixed(3)} m/s`));
  put(values["Limit"], live(`${picture.limit.toFixed(3)} m/s`));
  put(values["Limit"]?.previousElementSibling ?? undefined, `Limit: ${REASONS[picture.limitReason] ?? "unknown"}`);
  put(values["Cover data"], live(picture.coverAge_s < 0 ? "none yet" : `${(picture.coverAge_s * 1e3).toFixed(0)} ms old`));
  put(values["Cover rate"], live(`${picture.coverRate_hz.toFixed(0)} Hz`));
  const trip = Math.max(0, link?.roundTrip_ms ?? 0);
  put($("age"), `${trip.toFixed(0)} ms`);
  $("age").className = `chip ${trip < 100 ? "rests" : trip < 250 ? "slow" : "stopped"}`;
}

/** Confirmed by a picture that the gateway sent after the robot had carried the stop out, and by nothing else. */
function watchStop(now: number, picture: Picture | null | undefined): void {
  if (!stopping) return;
  if (picture && picture.live && picture.mode >= STOPPED && picture.stopConfirmed >= stopping.stop) {
    toast(`Stopped, confirmed after ${Math.round(now - stopping.at)} ms.`);
    stopping = null;
  } else if (now - stopping.at > STOP_MS) {
    toast("STOP is not confirmed: use the robot's own stop.", true);
    stopping = null;
  }
}

// Requests.
function stop(): void {
  end();
  const at = performance.now();
  if (link) stopping = { stop: link.stop(), at };
}
$("stop").addEventListener("pointerdown", event => { event.preventDefault(); stop(); });
$("stop").addEventListener("click", event => { if (event.detail === 0) stop(); }); // The keyboard's.
addEventListener("keydown", event => { if (event.key === "Escape") stop(); });

function begin(): void {
  if (!link || !link.open || link.press || $<HTMLButtonElement>("run").disabled) return;
  ran = false;
  $("run").classList.add("held");
  navigator.vibrate?.(30);
  link.begin(performance.now());
}
function end(): void {
  $("run").classList.remove("held");
  if (link?.press) link.end(performance.now());
}
holdToRun($("run"), begin, end);
$("tare").onclick = () => link?.ask("tare");
$("resume").onclick = () => link?.ask("resume");
for (const law of all("[data-law]")) law.onclick = () => link?.ask({ law: law.dataset["law"]! });

// Pairing.
$<HTMLFormElement>("pair").onsubmit = async event => {
  event.preventDefault();
  const body = JSON.stringify({ code: $<HTMLInputElement>("code").value, name: $<HTMLInputElement>("device").value });
  const headers = { "content-type": "application/json" };
  const paired = await fetch("/pair", { method: "POST", headers, body }).catch(() => null);
  if (paired?.ok) void start();
  else put($("pairerror"), paired ? await paired.text() : "no link to the robot");
};

async function start(): Promise<void> {
  const me = await fetch("/me").catch(() => null);
  $("pair").hidden = me?.ok ?? false;
  if (!me?.ok || link) return;
  link = new Link({
    state: see,
    reply: answer,
    closed: async why => {
      end();
      if (why) toast(why, true);
      // A device whose rights were taken away pairs again.
      if ((await fetch("/me").catch(() => null))?.status === 401) location.reload();
    },
  });
  Object.assign(window, { moca: link });
  requestAnimationFrame(draw);
  load();
  void others();
}
void start();
