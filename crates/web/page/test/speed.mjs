// Latency, bytes, processor and memory of the gateway; a slow radio that must not stop the robot.
import fs from "node:fs";
import net from "node:net";
import { Browser, Robot, check, finish, now, quantiles, sleep } from "./robot.mjs";

const N = Number(process.env.N ?? 20);
const robot = await Robot.start();
const browser = await Browser.start(robot);
await browser.pair("operator", "Speed");
const row = (name, values) => {
  const { n, p50, p90, max } = quantiles(values);
  return `${name.padEnd(46)} | ${n} | ${p50.toFixed(1)} | ${p90.toFixed(1)} | ${max.toFixed(1)}`;
};

async function latency(under) {
  const [press, stop, seen] = [[], [], []];
  for (let i = 0; i < N; i++) {
    press.push(await browser.run());
    await browser.page.evaluate(() => document.getElementById("stop").addEventListener("pointerdown",
      () => (window.stopped = performance.timeOrigin + performance.now()), { once: true, capture: true }));
    const { x, y } = await browser.centre("#stop");
    await browser.page.mouse.up();
    // Releasing comes first here, so the robot runs again for STOP.
    await browser.run();
    await browser.page.touchscreen.tap(x, y);
    const at = await browser.page.evaluate(() => window.stopped);
    const line = await robot.mode("protective stop", at);
    stop.push(line.unix_ms - at);
    await browser.page.waitForFunction(() => document.getElementById("toast").textContent.startsWith("Stopped"), null, { timeout: 5000 });
    seen.push(Number((await browser.page.textContent("#toast")).match(/\d+/)?.[0]));
    await browser.page.mouse.up();
  }
  check(quantiles(press).p90 <= 50, row(`press to mode${under}`, press));
  check(quantiles(stop).p90 <= 50, row(`STOP to mode${under}`, stop));
  console.log(`  ${row(`STOP to confirmed on the page${under}`, seen)}`);
}

/** Seconds of processor time so far. */
function processor(pid) {
  const fields = fs.readFileSync(`/proc/${pid}/stat`, "utf8").split(") ")[1].split(" ");
  return (Number(fields[11]) + Number(fields[12])) / 100;
}
const memory_mb = pid => Number(fs.readFileSync(`/proc/${pid}/status`, "utf8").match(/VmRSS:\s+(\d+)/)[1]) / 1024;

console.log("ms | n | p50 | p90 | max");
await latency("");

const bytes = () => browser.page.evaluate(() => window.moca.bytes);
const [before, begun] = [await bytes(), now()];
await sleep(5000);
const rate = (await bytes() - before) / (now() - begun);
check(rate <= 8, `bytes to a page: ${rate.toFixed(2)} kB/s`);

const pages = [];
for (let i = 0; i < 4; i++) {
  const page = await browser.context.newPage();
  await page.goto(browser.url);
  pages.push(page);
}
await browser.page.bringToFront();
await sleep(1000);
const cpu = processor(robot.gateway.pid);
const since = now();
await sleep(10000);
const share = (processor(robot.gateway.pid) - cpu) / ((now() - since) / 1000) * 100;
check(share <= 5, `processor of the gateway with 5 pages: ${share.toFixed(1)} % of a core`);
check(memory_mb(robot.gateway.pid) <= 20, `memory of the gateway with 5 pages: ${memory_mb(robot.gateway.pid).toFixed(1)} MB`);

// 16 pages, one of them floods with stops' equals: requests until it is closed, again and again.
for (let i = 0; i < 10; i++) {
  const page = await browser.context.newPage();
  await page.goto(browser.url);
  pages.push(page);
}
await pages[0].evaluate(() => setInterval(() => { for (let i = 0; i < 200; i++) window.moca?.ask("nonsense"); }, 20));
await browser.page.bringToFront();
await latency(", 16 pages, one floods");
for (const page of pages) await page.close();

// A radio: a proxy that holds bytes back, in order.
function proxy(delay_ms, stall) {
  const server = net.createServer(client => {
    const gateway = net.connect(robot.port, "127.0.0.1");
    for (const [from, to] of [[client, gateway], [gateway, client]]) {
      const queue = [];
      from.on("data", data => {
        let due = now() + delay_ms;
        if (stall) {
          const phase = now() % stall.every;
          if (phase < stall.ms) due = Math.max(due, now() + stall.ms - phase);
        }
        queue.push({ data, due: Math.max(due, queue.at(-1)?.due ?? 0) });
      });
      const timer = setInterval(() => { while (queue.length && queue[0].due <= now()) to.write(queue.shift().data); }, 1);
      for (const socket of [from, to]) socket.on("error", () => {}).on("close", () => { clearInterval(timer); to.destroy(); });
    }
  });
  return new Promise(resolve => server.listen(0, "127.0.0.1", () => resolve(server)));
}
for (const [name, delay, stall] of [["round trip 160 ms", 80, null], ["a stall of 250 ms every 4 s", 2, { every: 4000, ms: 250 }]]) {
  const server = await proxy(delay, stall);
  // The gateway knows its own port only: the browser is told that the proxy's is it.
  const through = await Browser.start(robot, { flags: [`--host-resolver-rules=MAP ${robot.host}:${robot.port} 127.0.0.1:${server.address().port}`] });
  await through.pair("operator", name);
  await through.run();
  const held = now();
  await sleep(14000);
  const stops = robot.modes(held).filter(line => line.what === "protective stop").length;
  const trip = await through.page.evaluate(() => window.moca.roundTrip_ms);
  check(stops === 0, `${name}: ${stops} stops in 14 s of holding, round trip shown ${trip.toFixed(0)} ms`);
  await through.end();
  server.close();
}
await browser.end();
robot.end();
finish();
