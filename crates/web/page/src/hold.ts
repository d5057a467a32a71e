// Hold to run: a press lasts while a finger stays on the button, and ends with everything else.
const MARGIN_PX = 24;

export function holdToRun(button: HTMLButtonElement, begin: () => void, end: () => void): void {
  const inside = (event: PointerEvent) => {
    const box = button.getBoundingClientRect();
    return event.clientX > box.left - MARGIN_PX && event.clientX < box.right + MARGIN_PX
      && event.clientY > box.top - MARGIN_PX && event.clientY < box.bottom + MARGIN_PX;
  };
  button.addEventListener("pointerdown", event => {
    if (event.button !== 0 || !event.isPrimary) return;
    button.setPointerCapture(event.pointerId);
    begin();
  });
  button.addEventListener("pointermove", event => { if (!inside(event)) end(); });
  for (const kind of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) button.addEventListener(kind, end);
  button.addEventListener("keydown", event => {
    if (event.key !== " " || event.repeat) return;
    event.preventDefault();
    begin();
  });
  button.addEventListener("keyup", end);
  for (const kind of ["blur", "pagehide", "freeze"]) addEventListener(kind, end);
  document.addEventListener("visibilitychange", () => { if (document.hidden) end(); });
  addEventListener("contextmenu", event => event.preventDefault());
}
