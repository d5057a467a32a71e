// Sizes, contrast, and that nothing covers STOP: each page, three screens, light and dark. With a folder as argument the pictures of
// the documentation are written there.
import { Browser, Robot, SIZES, check, finish, sleep } from "./robot.mjs";

const folder = process.argv[2];
const PICTURES = { "tablet light cover": "tablet-running", "laptop dark cover": "laptop-dark", "laptop light maintain": "laptop-maintain",
  "tablet dark robots": "tablet-robots" };
// The documentation's pictures show the robot of the paper, which has no gripper.
const robot = await Robot.start({ lease_ms: 1000, gripper: !folder }); // nothing here depends on the lease

/** Measured in the page. */
function measure() {
  const visible = element => element.checkVisibility() && element.getBoundingClientRect().width > 0;
  const rgb = text => {
    const [r, g, b, a = 1] = text.match(/[\d.]+/g).map(Number);
    return { r, g, b, a };
  };
  const luminance = ({ r, g, b }) => [r, g, b].map(v => v / 255).map(v => (v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const behind = element => {
    for (let at = element; at; at = at.parentElement) {
      const colour = rgb(getComputedStyle(at).backgroundColor);
      if (colour.a > 0.99) return colour;
    }
    return { r: 255, g: 255, b: 255 };
  };
  const contrast = (a, b) => {
    const [dark, light] = [luminance(a), luminance(b)].sort((x, y) => x - y);
    return (light + 0.05) / (dark + 0.05);
  };
  const texts = [...document.querySelectorAll("body *")].filter(element => visible(element)
    && [...element.childNodes].some(node => node.nodeType === 3 && node.textContent.trim()));
  const worst = { ratio: 99, text: "" };
  for (const element of texts) {
    const svg = element instanceof SVGElement;
    const style = getComputedStyle(element);
    let back = behind(element);
    if (svg) {
      const box = element.parentElement.querySelector(".taxel");
      back = rgb(getComputedStyle(box ?? document.querySelector("#ring .body")).fill);
    }
    const ratio = contrast(rgb(svg ? style.fill : style.color), back);
    if (ratio < worst.ratio) Object.assign(worst, { ratio, text: `${element.tagName} ${element.textContent.trim().slice(0, 30)}` });
  }
  const targets = [...document.querySelectorAll("button, a, input")].filter(visible).map(element => {
    const { x, y, width, height } = element.getBoundingClientRect();
    return { element, name: element.id || element.textContent.trim().slice(0, 20), x, y, width, height };
  });
  // Of a list that scrolls, what is beyond its edge cannot be touched.
  for (const t of targets) {
    const list = t.element.closest("section")?.getBoundingClientRect();
    if (list) [t.from, t.to] = [Math.max(t.y, list.top), Math.min(t.y + t.height, list.bottom)];
    else [t.from, t.to] = [t.y, t.y + t.height];
  }
  const seen = targets.filter(t => t.element.contains(document.elementFromPoint(t.x + t.width / 2, t.y + t.height / 2)));
  const small = targets.filter(t => t.width < 48 || t.height < 48).map(t => `${t.name} ${t.width.toFixed(0)}x${t.height.toFixed(0)}`);
  const near = [];
  for (const [i, a] of seen.entries()) for (const b of seen.slice(i + 1)) {
    const gap = Math.max(Math.max(a.x, b.x) - Math.min(a.x + a.width, b.x + b.width),
      Math.max(a.from, b.from) - Math.min(a.to, b.to));
    if (gap < 7.5) near.push(`${a.name} and ${b.name}: ${gap.toFixed(1)}`);
  }
  const stop = document.getElementById("stop").getBoundingClientRect();
  const points = [[0.5, 0.5], [0.05, 0.1], [0.95, 0.1], [0.05, 0.9], [0.95, 0.9]];
  const free = points.every(([u, v]) =>
    document.elementFromPoint(stop.x + u * stop.width, stop.y + v * stop.height)?.closest("#stop"));
  const inside = stop.x >= 0 && stop.y >= 0 && stop.right <= innerWidth && stop.bottom <= innerHeight;
  return { worst, small, near, stop: { width: stop.width, height: stop.height, free, inside },
    wide: document.documentElement.scrollWidth <= innerWidth };
}

console.log("screen, page | STOP px | smallest contrast");
for (const size of Object.keys(SIZES)) for (const dark of [false, true]) {
  const browser = await Browser.start(robot, { size, dark });
  const theme = dark ? "dark" : "light";
  await browser.pair("maintainer", `${size} ${theme}`);
  await browser.run();
  // Somebody leans on the cover while it is looked at.
  const cell = await browser.centre("#ring g:nth-of-type(6)");
  await browser.page.evaluate(() => window.moca.ask({ "press-taxel": { taxel: 5, force_n: 12 } }));
  await sleep(900);
  for (const page of ["cover", "plot", "robot", ...(folder ? [] : ["gripper"]), "logs", "maintain", "robots"]) {
    await browser.page.evaluate(to => document.querySelector(`[data-to=${to}]`).click(), page);
    await sleep(page === "robot" ? 2500 : 700);
    const seen = await browser.page.evaluate(measure);
    const name = `${size} ${theme} ${page}`;
    const { stop } = seen;
    check(stop.free && stop.inside && stop.width >= 96 && stop.height >= 96 && seen.worst.ratio >= 4.5 && !seen.small.length
      && !seen.near.length && seen.wide,
      `${name.padEnd(24)} | ${stop.width.toFixed(0)}x${stop.height.toFixed(0)}${stop.free ? "" : " covered"}${stop.inside ? "" : " outside"} | `
      + `${seen.worst.ratio.toFixed(1)} ${seen.worst.text} ${[...seen.small, ...seen.near].join("; ")}${seen.wide ? "" : " too wide"}`);
    if (folder && PICTURES[name]) await browser.page.screenshot({ path: `${folder}/${PICTURES[name]}.png` });
  }
  check(!browser.foreign.length, `${size} ${theme}: requests to other hosts: ${browser.foreign.length} ${browser.foreign[0] ?? ""}`);
  check(!browser.errors.length, `${size} ${theme}: errors in the console: ${browser.errors.length} ${browser.errors[0] ?? ""}`);
  await browser.page.mouse.up();
  void cell;
  if (folder && size === "phone" && !dark) {
    await browser.page.evaluate(() => document.querySelector("[data-to=cover]").click());
    await browser.run();
    await browser.page.evaluate(() => document.getElementById("stop").click());
    await robot.mode("protective stop");
    await sleep(700);
    await browser.page.screenshot({ path: `${folder}/phone-stopped.png` });
    await browser.page.mouse.up();
  }
  await browser.end();
  robot.command("revoke", `${size} ${theme}`);
}
robot.end();
finish();
