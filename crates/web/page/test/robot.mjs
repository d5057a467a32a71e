// A simulated robot, its gateway, and a second gateway that only observes: it dates every change of the robot's mode, also while
// the first one is frozen or gone.
import { spawn, execFileSync } from "node:child_process";
import fs from "node:fs";
import net from "node:net";
import os from "node:os";
import path from "node:path";
import { chromium } from "playwright-core";

const { MOCAD, MOCA_WEB } = process.env;
export const SIZES = { phone: [390, 844], tablet: [1180, 820], laptop: [1280, 800] };
export const sleep = ms => new Promise(resolve => setTimeout(resolve, ms));
export const now = () => performance.timeOrigin + performance.now();
export const FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
  "--disable-component-update", "--disable-sync", "--enable-unsafe-swiftshader"];

/** A gripper, and a cube of 50 mm between its fingers. */
const GRIPPER = `[plant]\ngripper = "simulated"\n[simulation.true.object]\nmass_kg = 0.5\n`;

/** Waits until `found` returns something; a test that would hang ends. */
export async function until(what, found, patience = 20000, story = async () => "") {
  for (const end = now() + patience; now() < end; await sleep(5)) {
    const value = await found();
    if (value) return value;
  }
  throw new Error(`never: ${what}\n${await story()}`);
}

export function quantiles(values) {
  const sorted = [...values].sort((a, b) => a - b);
  const at = share => sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] ?? NaN;
  return { n: sorted.length, p50: at(0.5), p90: at(0.9), max: sorted.at(-1) ?? NaN };
}

/** Seconds of processor time so far. */
export function processor(pid) {
  const fields = fs.readFileSync(`/proc/${pid}/stat`, "utf8").split(") ")[1].split(" ");
  return (Number(fields[11]) + Number(fields[12])) / 100;
}
export const memory_mb = pid => Number(fs.readFileSync(`/proc/${pid}/status`, "utf8").match(/VmRSS:\s+(\d+)/)[1]) / 1024;

/** Nothing that a campaign started outlives it, however it ends. */
const endings = new Set();
process.on("exit", () => { for (const end of endings) end(); });

export class Robot {
  static async start({ host = "localhost", listen = "127.0.0.1", within = [], port = 20000 + (process.pid % 20000), lease_ms = 400, list = null, gripper = false } = {}) {
    const robot = new Robot();
    Object.assign(robot, { host, listen, within, port, lease_ms, folder: fs.mkdtempSync(path.join(os.tmpdir(), "moca-page-")) });
    const file = name => path.join(robot.folder, name);
    fs.mkdirSync(file("logs"));
    fs.writeFileSync(file("logs/2026-11-24T09-30-00.mcap"), Buffer.alloc(3_400_000));
    robot.kill = () => {
      for (const child of [robot.gateway, robot.observer, robot.daemon]) child?.kill("SIGKILL");
      fs.rmSync(robot.folder, { recursive: true, force: true, maxRetries: 5 });
    };
    endings.add(robot.kill);
    robot.address = `unix:${file("telemetry.sock")}`;
    list ??= [{ name: "moca-lab-2", address: robot.address }, { name: "moca-lab-3", address: `unix:${file("away.sock")}` }];
    fs.writeFileSync(file("robots.toml"), list.map(({ name, address }) =>
      `[[robot]]\nname = "${name}"\naddress = "${address}"\npage = "https://${name}:7643/"\n`).join("\n"));
    fs.writeFileSync(file("mocad.toml"), `[robot]\nname = "moca-lab-2"\n[telemetry]\nlisten = "${robot.address}"\n[startup]\narm = false\n`
      + `[simulation.hand]\ntaxels = []\n${gripper ? GRIPPER : ""}`);
    robot.daemon = spawn(MOCAD, ["--config", file("mocad.toml")], { stdio: "ignore", cwd: robot.folder });
    await robot.serve();
    robot.observer = robot.spawn("observer", [], 0, "127.0.0.1");
    await robot.mode("ready");
    return robot;
  }

  spawn(state, within, port, listen) {
    const log = fs.openSync(path.join(this.folder, `${state}.log`), "a");
    const command = [...within, MOCA_WEB, "--state", path.join(this.folder, state), "--address", this.address, "--listen",
      `${listen}:${port}`, "--logs", path.join(this.folder, "logs"), "--robots", path.join(this.folder, "robots.toml"), "--name", this.host,
      "--name", listen, "--lease-ms", String(this.lease_ms)];
    return spawn(command[0], command.slice(1), { stdio: ["ignore", log, log] });
  }

  async serve() {
    this.gateway = this.spawn("gateway", this.within, this.port, this.listen);
    const said = path.join(this.folder, "gateway.log");
    await until("the gateway listens", () => fs.existsSync(said) && fs.readFileSync(said, "utf8").includes("https://"));
  }

  get url() { return `https://${this.host}:${this.port}/`; }

  command(...words) {
    return execFileSync(MOCA_WEB, ["--state", path.join(this.folder, "gateway"), ...words]).toString().trim();
  }

  audit(name = "observer") {
    const file = path.join(this.folder, name, "audit.jsonl");
    const lines = fs.existsSync(file) ? fs.readFileSync(file, "utf8").trim().split("\n").filter(Boolean) : [];
    return lines.map(line => JSON.parse(line));
  }

  /** Every mode that was entered after `since`, with its Unix time, ms. */
  modes(since = 0) {
    return this.audit().filter(line => line.who === "robot" && line.what !== "daemon away" && line.unix_ms >= Math.floor(since));
  }

  async mode(wanted, since = 0, patience = 20000) {
    return until(`mode ${wanted}`, () => this.modes(since).find(line => line.what === wanted), patience);
  }

  present() { return this.modes().at(-1)?.what; }

  end() {
    this.kill();
    endings.delete(this.kill);
  }
}

/** A radio: holds bytes back, in order; `due` says when those that come at a time are passed on, to the robot or from it. */
export function radio(robot, due) {
  const server = net.createServer(client => {
    const gateway = net.connect(robot.port, robot.listen);
    for (const [from, to] of [[client, gateway], [gateway, client]]) {
      const queue = [];
      from.on("data", data => queue.push({ data, due: Math.max(due(now(), to === gateway), queue.at(-1)?.due ?? 0) }));
      const timer = setInterval(() => { while (queue.length && queue[0].due <= now()) to.write(queue.shift().data); }, 1);
      for (const socket of [from, to]) socket.on("error", () => {}).on("close", () => { clearInterval(timer); to.destroy(); });
    }
  });
  return new Promise(resolve => server.listen(0, "127.0.0.1", () => resolve({
    // The gateway knows its own port only: the browser is told that this one is it.
    flags: [`--host-resolver-rules=MAP ${robot.host}:${robot.port} 127.0.0.1:${server.address().port}`],
    close: () => server.close(),
  })));
}

/** Shortest time between two runs. The observer's audit has two lines a second for the robot, and a run changes its mode three times:
 *  what comes faster is counted there and not dated. */
const PACE_MS = 2000;

export class Browser {
  ran = -Infinity;

  static async start(robot, { size = "tablet", dark = false, within = [], flags = [] } = {}) {
    const browser = new Browser();
    browser.profile = fs.mkdtempSync(path.join(os.tmpdir(), "moca-chromium-"));
    browser.kill = () => {
      browser.signal("SIGKILL");
      fs.rmSync(browser.profile, { recursive: true, force: true, maxRetries: 5 });
    };
    endings.add(browser.kill);
    let executablePath = "/usr/bin/chromium";
    if (within.length) {
      executablePath = path.join(browser.profile, "chromium-within");
      fs.writeFileSync(executablePath, `#!/bin/sh\nexec ${within.join(" ")} /usr/bin/chromium "$@"\n`, { mode: 0o755 });
    }
    const [width, height] = SIZES[size];
    browser.context = await chromium.launchPersistentContext(path.join(browser.profile, "user"), {
      executablePath, args: [...FLAGS, ...flags], ignoreHTTPSErrors: true, hasTouch: true, viewport: { width, height },
      colorScheme: dark ? "dark" : "light",
    });
    browser.page = browser.context.pages()[0] ?? await browser.context.newPage();
    browser.robot = robot;
    browser.url = robot.url;
    browser.foreign = [];
    browser.errors = [];
    browser.page.on("request", request => {
      const { host, protocol } = new URL(request.url());
      if (protocol !== "data:" && host !== new URL(browser.url).host) browser.foreign.push(request.url());
    });
    browser.page.on("console", message => { if (message.type() === "error" && !message.text().includes("401")) browser.errors.push(message.text()); });
    browser.page.on("pageerror", error => browser.errors.push(String(error)));
    return browser;
  }

  async pair(role, name) {
    await this.page.goto(this.url);
    await this.page.waitForSelector("#pair:not([hidden])");
    await this.page.fill("#code", this.robot.command("pair", role).split("\n")[0]);
    await this.page.fill("#device", name);
    await this.page.click("#pair button");
    await this.drawn();
  }

  /** Waits until the page has drawn a few pictures. */
  async drawn() { await this.page.waitForFunction(() => window.moca?.drawn > 3, null, { timeout: 20000 }); }

  /** Processes of this browser alone. */
  processes() {
    return fs.readdirSync("/proc").filter(name => /^\d+$/.test(name)).map(Number).filter(pid => {
      try { return fs.readFileSync(`/proc/${pid}/cmdline`, "utf8").includes(this.profile); } catch { return false; }
    });
  }

  signal(signal) { for (const pid of this.processes()) try { process.kill(pid, signal); } catch { /* it has ended */ } }

  async centre(selector) {
    const box = await this.page.locator(selector).boundingBox();
    return { ...box, x: box.x + box.width / 2, y: box.y + box.height / 2 };
  }

  /** Presses hold to run; the time of the press in the page. */
  async press() {
    const { x, y } = await this.centre("#run");
    await this.page.evaluate(() => addEventListener("pointerdown", () => (window.pressed = performance.timeOrigin + performance.now()),
      { once: true, capture: true }));
    await this.page.mouse.move(x, y);
    await this.page.mouse.down();
    return this.page.evaluate(() => window.pressed);
  }

  /** Brings the robot to ready, presses, and waits until it has run for a while. */
  async run() {
    for (let attempt = 0; attempt < 10; attempt++) {
      await sleep(Math.max(0, this.ran + PACE_MS - now()));
      this.ran = now();
      await this.ready();
      const pressed = await this.press();
      const armed = await this.robot.mode("impedance", pressed, 3000).catch(() => null);
      if (armed) {
        await sleep(400);
        if (this.robot.present() === "impedance") return armed.unix_ms - pressed;
      }
      await this.page.mouse.up();
    }
    const last = this.robot.audit("gateway").slice(-6).map(line => `${line.who}: ${line.what}: ${line.outcome}`);
    throw new Error(`the robot does not run\n${last.join("\n")}`);
  }

  async ready() {
    await until("ready", async () => {
      const mode = this.robot.present();
      if (mode === "protective stop") await this.page.evaluate(() => document.getElementById("resume").click());
      const free = await this.page.evaluate(() => !document.getElementById("run").disabled);
      if (mode !== "ready" || !free) await sleep(200);
      return mode === "ready" && free;
    }, 20000, () => this.story());
  }

  /** What the robot and the page say, for a failure. */
  async story() {
    const said = id => this.page.evaluate(id => document.getElementById(id)?.textContent, id);
    const page = await Promise.all(["mode", "fault", "runtext", "who", "toast", "age"].map(async id => `${id}: ${await said(id)}`));
    const audit = ["observer", "gateway"].flatMap(name => this.robot.audit(name).slice(-8).map(line =>
      `${name} ${line.unix_ms}: ${line.who}: ${line.what}: ${JSON.stringify(line.outcome)}`));
    return [...page, ...audit].join("\n");
  }

  async end() {
    await this.context.close().catch(() => {});
    this.kill();
    endings.delete(this.kill);
  }
}

/** Prints a row and notes what fails. */
export const failures = [];
export function check(holds, text) {
  console.log(`${holds ? "  " : "! "}${text}`);
  if (!holds) failures.push(text);
}
export function finish() {
  if (failures.length) { console.error(`${failures.length} checks failed`); process.exit(1); }
}
