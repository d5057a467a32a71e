// The link is cut while somebody holds the robot: how long until it stops? Packets are dropped by routes between two network
// namespaces; without the right to make them those rows are left out, and say so.
import { execFileSync } from "node:child_process";
import { Browser, Robot, check, finish, now, quantiles, radio, sleep } from "./robot.mjs";

const N = Number(process.env.N ?? 5);
const LIMIT_MS = 600;
const REVOKED_MS = 1000;
/** Longest time after which bytes that were held back have come, or the kernel has sent them again. */
const DELIVERED_MS = 1500;
const [ROBOT, TABLET] = [`mr${process.pid}`, `mt${process.pid}`];
const ip = (...words) => execFileSync("ip", words, { stdio: ["ignore", "pipe", "pipe"] });
const inRobot = ["ip", "netns", "exec", ROBOT];
const inTablet = ["ip", "netns", "exec", TABLET];
const wanted = process.argv[2]?.split(",");

function namespaces() {
  try {
    for (const name of [ROBOT, TABLET]) ip("netns", "add", name);
    ip("link", "add", "robot", "netns", ROBOT, "type", "veth", "peer", "name", "tablet", "netns", TABLET);
    ip("-n", ROBOT, "addr", "add", "192.0.2.1/24", "dev", "robot");
    ip("-n", TABLET, "addr", "add", "192.0.2.2/24", "dev", "tablet");
    for (const [name, link] of [[ROBOT, "robot"], [TABLET, "tablet"], [ROBOT, "lo"], [TABLET, "lo"]]) ip("-n", name, "link", "set", link, "up");
    return true;
  } catch (error) {
    console.log(`no network namespaces here: ${error.message.split("\n")[0]}`);
    return false;
  }
}
const block = (namespace, address) => ip("-n", namespace, "route", "add", "blackhole", `${address}/32`);
const unblock = (namespace, address) => ip("-n", namespace, "route", "del", "blackhole", `${address}/32`);

/** Each cuts the link and returns how to mend it; `cut` is called at once before. */
const local = {
  "browser SIGSTOP": async ({ browser, cut }) => { cut(); browser.signal("SIGSTOP"); return () => browser.signal("SIGCONT"); },
  "browser killed": async ({ browser, cut }) => { cut(); browser.signal("SIGKILL"); return "new browser"; },
  "page hangs": async ({ browser, cut }) => {
    cut();
    browser.page.evaluate(() => { const end = Date.now() + 2500; while (Date.now() < end); }).catch(() => {});
    return () => sleep(2600);
  },
  "tab hidden": async ({ browser, cut }) => {
    const other = await browser.context.newPage();
    cut();
    await other.bringToFront();
    // A switch of tabs takes the browser its time: the page itself knows its last sign of life.
    const last = () => browser.page.evaluate(() => performance.timeOrigin + window.moca.lastBeat);
    return Object.assign(async () => { await other.close(); await browser.page.bringToFront(); }, { last });
  },
  "gateway killed": async ({ robot, cut }) => {
    cut();
    robot.gateway.kill("SIGKILL");
    return async () => { await sleep(300); await robot.serve(); await sleep(1500); };
  },
  "gateway SIGSTOP": async ({ robot, cut }) => {
    cut();
    robot.gateway.kill("SIGSTOP");
    return async () => { robot.gateway.kill("SIGCONT"); await sleep(1000); };
  },
};
/** Signs of life come late, all at once. */
let held_back = 0;
const late = {
  "signs of life come 3 s late": async ({ cut }) => {
    cut();
    held_back = now() + 3000;
    return () => sleep(held_back - now());
  },
};
const revoked = {
  "rights revoked": async ({ robot, browser, cut }) => { cut(); robot.command("revoke", browser.name); return "new browser"; },
};
const links = {
  "packets dropped both ways": async ({ cut }) => {
    cut();
    block(ROBOT, "192.0.2.2"); block(TABLET, "192.0.2.1");
    return () => { unblock(ROBOT, "192.0.2.2"); unblock(TABLET, "192.0.2.1"); };
  },
  "tablet to robot dropped": async ({ cut }) => { cut(); block(TABLET, "192.0.2.1"); return () => unblock(TABLET, "192.0.2.1"); },
  "robot to tablet dropped": async ({ cut }) => { cut(); block(ROBOT, "192.0.2.2"); return () => unblock(ROBOT, "192.0.2.2"); },
  "interface down": async ({ cut }) => {
    cut();
    ip("-n", TABLET, "link", "set", "tablet", "down");
    return () => ip("-n", TABLET, "link", "set", "tablet", "up");
  },
};

async function campaign(ways, place, { within = [], limit_ms = LIMIT_MS, due = null } = {}) {
  let robot = null, browser = null, through = null;
  const open = async () => {
    through ??= due && await radio(robot, due);
    browser = await Browser.start(robot, { within, flags: through?.flags });
    browser.name = `Cut ${now().toFixed(0)}`;
    await browser.pair("operator", browser.name);
  };
  for (const [name, way] of Object.entries(ways).filter(([name]) => !wanted || wanted.includes(name))) {
    robot ??= await Robot.start(place);
    const times = [];
    const causes = new Set();
    for (let i = 0; i < N; i++) {
      if (!browser) await open();
      await browser.run();
      let begun = 0;
      const mend = await way({ robot, browser, cut: () => (begun = now()) });
      const line = await robot.mode("protective stop", begun, 8000).catch(() => null);
      times.push(line ? line.unix_ms - (mend.last ? await mend.last() : begun) : Infinity);
      causes.add(line?.outcome ?? "none");
      if (mend === "new browser") { await browser.end(); browser = null; continue; }
      await mend();
      await sleep(DELIVERED_MS);
      // Signs of life that were held back meanwhile have come by now: none of them revives the robot.
      const later = robot.modes((line?.unix_ms ?? begun) + 1).filter(({ what }) => what !== "protective stop");
      if (later.length) check(false, `${name}: ${later[0].what} after the stop`);
      await browser.page.mouse.up().catch(() => {});
      await browser.drawn();
    }
    const { n, p50, max } = quantiles(times);
    check(max <= limit_ms, `${name.padEnd(26)} | ${n} | ${p50.toFixed(0)} | ${max.toFixed(0)} | ${[...causes].join("; ")}`);
  }
  through?.close();
  await browser?.end();
  robot?.end();
}

console.log("cut | n | ms until the stop: p50 | max | cause");
await campaign(local, {});
await campaign(late, {}, { due: (at, to_robot) => (to_robot ? Math.max(at, held_back) : at) });
await campaign(revoked, {}, { limit_ms: REVOKED_MS });
if (namespaces()) {
  try {
    await campaign(links, { host: "192.0.2.1", listen: "192.0.2.1", within: inRobot }, { within: inTablet });
  } finally {
    for (const name of [ROBOT, TABLET]) ip("netns", "del", name);
  }
}
finish();
