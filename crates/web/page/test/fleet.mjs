// Several robots at one gateway: what they cost it, how soon it sees one stop, go and return, and that the others notice nothing.
//     node test/fleet.mjs 1,5,10,20      with MOCAD of a release build: each robot takes a tenth of a core
import { spawn } from "node:child_process";
import fs from "node:fs";
import os from "node:os";
import path from "node:path";
import { Browser, Robot, check, finish, memory_mb, now, processor, quantiles, sleep, until } from "./robot.mjs";

const { MOCAD } = process.env;
const BACK_MS = 2000;
const N = Number(process.env.N ?? 5);
const started = [];
process.on("exit", () => { for (const child of started) child.kill("SIGKILL"); });

/** A daemon of the list. */
class Listed {
  constructor(folder, name) {
    Object.assign(this, { name, config: path.join(folder, `${name}.toml`), address: `unix:${path.join(folder, `${name}.sock`)}` });
    fs.writeFileSync(this.config, `[robot]\nname = "${name}"\n[telemetry]\nlisten = "${this.address}"\n[startup]\narm = false\n`
      + `[simulation.hand]\ntaxels = []\n[flight_recorder]\nfolder = ""\n`);
    this.start();
  }
  start() { started.push(this.daemon = spawn(MOCAD, ["--config", this.config], { stdio: "ignore" })); }
  command(word) { return new Promise(resolve => spawn(MOCAD, [word, "--address", this.address], { stdio: "ignore" }).on("exit", resolve)); }
}

console.log("robots | gateway % of a core | MB | a robot % of a core | MB | stop seen, ms: p50, max | gone seen, ms | started to seen, ms: max "
  + "| load");
for (const count of (process.argv[2] ?? "1,3").split(",").map(Number)) {
  const folder = fs.mkdtempSync(path.join(os.tmpdir(), "moca-fleet-"));
  const robots = Array.from({ length: count }, (_, i) => new Listed(folder, `robot-${i + 1}`));
  const own = await Robot.start({ list: robots.map(({ name, address }) => ({ name, address })) });
  const browser = await Browser.start(own);
  await browser.pair("operator", "Fleet");
  // Slower than the gateway's bound on requests from one address; times are exact to this.
  const look = () => sleep(25).then(() => browser.page.evaluate(() => fetch("/robots").then(answer => answer.json())));
  const seen = async (name, wanted) => (await look()).find(robot => robot.name === name && wanted(robot));
  for (const { name } of robots) await until(`${name} ready`, () => seen(name, robot => robot.mode === "ready"), 60000);
  const spent = () => [processor(own.gateway.pid), robots.reduce((sum, { daemon }) => sum + processor(daemon.pid), 0)];
  const [before, at] = [spent(), now()];
  for (const end = now() + 5000; now() < end; await sleep(1000)) await look();
  const [share, all] = spent().map((after, i) => (after - before[i]) / ((now() - at) / 1000) * 100);
  const robot_mb = robots.reduce((sum, { daemon }) => sum + memory_mb(daemon.pid), 0) / count;
  const [stops, gone, back] = [[], [], []];
  for (let i = 0; i < N; i++) {
    const robot = robots[i % count];
    const others = async () => (await look()).filter(({ name }) => name !== robot.name);
    let begun = now();
    const stopped = robot.command("stop");
    await until("the stop", () => seen(robot.name, ({ mode }) => mode === "protective stop"));
    stops.push(now() - begun);
    await stopped;
    robot.daemon.kill("SIGKILL");
    begun = now();
    await until("gone", () => seen(robot.name, ({ away }) => away));
    gone.push(now() - begun);
    check((await others()).every(({ mode }) => mode === "ready"), `the others while ${robot.name} stops and goes: ready`);
    robot.start();
    begun = now();
    await until("back", () => seen(robot.name, ({ away }) => !away));
    back.push(now() - begun);
    await until("ready", () => seen(robot.name, ({ mode }) => mode === "ready"), 60000);
  }
  const [stop, away, again] = [stops, gone, back].map(quantiles);
  check(again.max <= BACK_MS, `${count} | ${share.toFixed(1)} | ${memory_mb(own.gateway.pid).toFixed(1)} | `
    + `${(all / count).toFixed(1)} | ${robot_mb.toFixed(1)} | ${stop.p50.toFixed(0)}, `
    + `${stop.max.toFixed(0)} | ${away.max.toFixed(0)} | ${again.max.toFixed(0)} | ${os.loadavg()[0].toFixed(1)}`);
  await browser.end();
  own.end();
  for (const { daemon } of robots) daemon.kill("SIGKILL");
  fs.rmSync(folder, { recursive: true, force: true, maxRetries: 5 });
}
finish();
