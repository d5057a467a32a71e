// Fingers: each way to end a press, and STOP from every page.
import { Browser, Robot, check, finish, now, sleep, until } from "./robot.mjs";

const robot = await Robot.start({ lease_ms: 1000 }); // nothing here depends on it;
const browser = await Browser.start(robot);
await browser.pair("operator", "Fingers");
const devtools = await browser.context.newCDPSession(browser.page);
const touch = (type, points) => devtools.send("Input.dispatchTouchEvent", { type, touchPoints: points });

async function finger() {
  await browser.ready();
  const at = await browser.centre("#run");
  const begun = now();
  await touch("touchStart", [{ x: at.x, y: at.y, id: 1 }]);
  await robot.mode("impedance", begun);
  await sleep(250);
  return at;
}

const ways = {
  "finger up": ["ready", () => touch("touchEnd", [])],
  "slid off": ["ready", at => touch("touchMove", [{ x: at.x, y: at.y - at.height - 80, id: 1 }])],
  "touch cancelled": ["ready", () => touch("touchCancel", [])],
  "window loses focus": ["ready", () => browser.page.evaluate(() => dispatchEvent(new Event("blur")))],
  "page frozen": ["ready", () => browser.page.evaluate(() => dispatchEvent(new Event("freeze")))],
  "Escape": ["protective stop", () => browser.page.keyboard.press("Escape")],
  "second finger on STOP": ["protective stop", async at => {
    const stop = await browser.centre("#stop");
    await touch("touchStart", [{ x: at.x, y: at.y, id: 1 }, { x: stop.x, y: stop.y, id: 2 }]);
  }],
};
console.log("way to end a press | mode | ms, tool included");
for (const [name, [mode, end]] of Object.entries(ways)) {
  const at = await finger();
  const begun = now();
  await end(at);
  const line = await robot.mode(mode, begun, 3000).catch(() => null);
  check(line, `${name.padEnd(22)} | ${line?.what ?? robot.present()} | ${line ? Math.round(line.unix_ms - begun) : "never"}`);
  await touch("touchCancel", []).catch(() => {});
  await sleep(300);
}
// A finger that stays on the button over a stop and a resume arms nothing.
await finger();
const escaped = now();
await browser.page.keyboard.press("Escape");
await robot.mode("protective stop", escaped);
await browser.page.waitForFunction(() => !document.getElementById("resume").disabled);
const resumed = now();
await browser.page.evaluate(() => document.getElementById("resume").click());
await robot.mode("ready", resumed);
await sleep(1000);
check(robot.present() === "ready", `a finger that stays over stop and resume: ${robot.present()}`);
await touch("touchEnd", []);
for (const page of ["plot", "logs"]) {
  await browser.ready();
  await browser.page.evaluate(to => document.querySelector(`[data-to=${to}]`).click(), page);
  const begun = now();
  const { x, y } = await browser.centre("#stop");
  await browser.page.touchscreen.tap(x, y);
  check(await robot.mode("protective stop", begun, 3000).catch(() => null), `STOP on page ${page}`);
}
// State that is old is shown as old.
const shown = () => browser.page.evaluate(() => ({ stale: document.body.classList.contains("stale"),
  numbers: [...document.querySelectorAll("#ring .force, #ring .most, #values dd")].map(e => e.textContent).filter(text => /\d/.test(text)) }));
await browser.page.evaluate(() => document.querySelector("[data-to=cover]").click());
await browser.drawn();
check((await shown()).numbers.length > 6, "numbers are shown while they are live");
robot.gateway.kill("SIGSTOP");
await sleep(500);
const old = await shown();
check(old.stale && !old.numbers.length, `0.5 s without a picture: ${old.stale ? "greyed" : "shown as live"}, ${old.numbers.length} numbers`);
robot.gateway.kill("SIGCONT");
await until("live again", async () => !(await shown()).stale);
await browser.end();
robot.end();
finish();
