// The gripper's page: grasp by a thumb, and nothing that is held opens by one press.
import { Browser, Robot, check, finish, sleep, until } from "./robot.mjs";

const bare = await Robot.start({ lease_ms: 1000 });
const other = await Browser.start(bare);
await other.pair("operator", "Bare");
const tab = browser => browser.page.locator("[data-to=gripper]").isVisible();
check(!await tab(other), "a robot without a gripper has no page of one");
await other.end();
bare.end();

const robot = await Robot.start({ lease_ms: 1000, gripper: true });
const browser = await Browser.start(robot, { size: "phone" });
const { page } = browser;
await browser.pair("operator", "Thumb");
const said = () => page.textContent("#fingers");
const says = text => until(text, async () => (await said()).includes(text), 10000, async () => `${await said()}\n${await browser.story()}`);
const tap = async selector => {
  await page.locator(selector).scrollIntoViewIfNeeded();
  const { x, y } = await browser.centre(selector);
  await page.touchscreen.tap(x, y);
};
const question = async () => (await page.textContent("#release small")).includes("press again");
const open = () => page.evaluate(() => document.querySelector("[data-to=gripper]").click());
await until("ready", () => robot.present() === "ready");
await open();
await says("resting · 80.0 mm");
check(true, await said());

// The mass is told by the slider's keys, as a finger drags it.
await page.focus("#mass");
for (let i = 0; i < 10; i++) await page.keyboard.press("ArrowRight");
check((await page.textContent("label:has(#mass) output")) === "0.5 kg", "ten steps of the mass are 0.5 kg");
await tap("#grasp");
await says("holding · 50.0 mm · 0.50 kg carried");
check(true, await said());

await tap("#release");
check(await question() && (await said()).startsWith("holding"), "one press asks");
await tap("#release");
await sleep(300);
check(await question() && (await said()).startsWith("holding"), "a second one at once is the same press");
await sleep(4200);
check(!await question() && (await said()).startsWith("holding"), "a question without an answer ends");
await tap("#halt");
await sleep(300);
check((await said()).startsWith("holding"), "fingers that stop hold on");
// What was grasped last is grasped next.
await page.reload();
await browser.drawn();
await open();
check((await page.textContent("label:has(#mass) output")) === "0.5 kg", "the next page begins with the last grasp");

// Old state is not shown as live, and an object may be held.
robot.gateway.kill("SIGSTOP");
await until("stale", () => page.evaluate(() => document.body.classList.contains("stale")));
await sleep(100);
check(await said() === "–", `0.5 s without a picture: ${await said()}`);
robot.gateway.kill("SIGCONT");
await says("holding");
await browser.drawn();
await tap("#release");
await sleep(600);
await tap("#release");
await says("resting · 80.0 mm");
check(!await question(), "two presses let go");
await tap("#release");
await sleep(300);
check(!await question(), "open fingers are opened without a question");

// A fault is seen from every page, and a viewer asks nothing.
await page.focus("#width");
await page.keyboard.press("Home");
for (let i = 0; i < 20; i++) await page.keyboard.press("ArrowRight");
await tap("#grasp");
await until("the fault", async () => (await page.textContent("#fault")).includes("wider than asked"));
await page.evaluate(() => document.querySelector("[data-to=cover]").click());
check(await page.locator("#fault").isVisible(), await page.textContent("#fault"));
await browser.end();
const viewer = await Browser.start(robot);
await viewer.pair("viewer", "Viewer");
await viewer.page.evaluate(() => document.querySelector("[data-to=gripper]").click());
const enabled = await viewer.page.locator("#gripper button:enabled").count();
check(enabled === 0, `buttons for a viewer: ${enabled}`);
check(!browser.errors.length && !viewer.errors.length, `errors in the console: ${[...browser.errors, ...viewer.errors].join("; ")}`);
await viewer.end();
robot.end();
finish();
