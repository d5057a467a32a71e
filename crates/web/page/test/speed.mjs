// Latency, bytes, processor and memory of the gateway; a slow radio that must not stop the robot.
import { Browser, Robot, check, finish, memory_mb, now, processor, quantiles, radio, sleep } from "./robot.mjs";

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

for (const [name, delay, stall] of [["round trip 160 ms", 80, null], ["a stall of 250 ms every 4 s", 2, { every: 4000, ms: 250 }]]) {
  const held_back = await radio(robot, at => {
    const phase = stall ? at % stall.every : Infinity;
    return at + Math.max(delay, phase < (stall?.ms ?? 0) ? stall.ms - phase : 0);
  });
  const through = await Browser.start(robot, { flags: held_back.flags });
  await through.pair("operator", name);
  await through.run();
  const held = now();
  await sleep(14000);
  // Every change of mode ends the running: a release that nobody made is a false stop too.
  const stops = robot.modes(held).length;
  const trip = await through.page.evaluate(() => window.moca.roundTrip_ms);
  check(stops === 0, `${name}: ${stops} stops in 14 s of holding, round trip shown ${trip.toFixed(0)} ms`);
  await through.end();
  held_back.close();
}
await browser.end();
robot.end();
finish();
