// Another site's page in the browser that is paired with the robot, and a browser that does not trust the robot's authority.
import http from "node:http";
import { chromium } from "playwright-core";
import { Browser, FLAGS, Robot, check, finish, sleep } from "./robot.mjs";

const robot = await Robot.start();
const browser = await Browser.start(robot);
await browser.pair("operator", "Paired");

const site = http.createServer((_, response) => response.setHeader("content-type", "text/html").end("<!doctype html><title>evil</title>"));
await new Promise(resolve => site.listen(0, "127.0.0.1", resolve));
const evil = await browser.context.newPage();
await evil.goto(`http://127.0.0.1:${site.address().port}/`);
const tried = await evil.evaluate(async robot => {
  const socket = await new Promise(resolve => {
    const socket = new WebSocket(`${robot.replace("https", "wss")}socket`);
    socket.onopen = () => resolve("open");
    socket.onclose = socket.onerror = () => resolve("refused");
  });
  const read = await fetch(`${robot}me`, { credentials: "include" }).then(() => "read", () => "refused");
  await fetch(`${robot}stop`, { method: "POST", mode: "no-cors", credentials: "include" }).catch(() => {});
  const frame = document.createElement("iframe");
  frame.src = robot;
  document.body.append(frame);
  await new Promise(resolve => { frame.onload = resolve; setTimeout(resolve, 3000); });
  return { socket, read };
}, robot.url);
check(tried.socket === "refused", `another site's page, socket: ${tried.socket}`);
check(tried.read === "refused", `another site's page, fetch: ${tried.read}`);
await sleep(500);
check(robot.present() === "ready", `another site's page, STOP by POST: the robot is ${robot.present()}`);
const framed = await Promise.all(evil.frames().slice(1).map(frame => frame.evaluate(() => !!document.getElementById("stop")).catch(() => false)));
check(framed.length === 1 && !framed[0], `another site's page, frame: ${framed[0] ? "shown" : "refused"}`);
const noted = robot.audit("gateway").filter(line => line.what.includes("another site"));
check(noted.length >= 2 && noted.every(line => line.outcome.includes("127.0.0.1")), `written down: ${noted.length} lines`);
await browser.page.bringToFront();
await browser.drawn();
site.close();
await browser.end();

const stranger = await chromium.launch({ executablePath: "/usr/bin/chromium", args: FLAGS });
const page = await stranger.newPage();
const refused = await page.goto(robot.url).then(() => "shown", error => String(error).match(/ERR_[A-Z_]+/)?.[0]);
check(refused === "ERR_CERT_AUTHORITY_INVALID", `a browser without the robot's authority: ${refused}`);
await stranger.close();
robot.end();
finish();
