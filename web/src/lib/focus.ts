// Where a keyboard was before a dialog: a button that is pressed is disabled while its order is on its way, and what is
// disabled loses the focus before the dialog comes. So the last place outside of dialogs is remembered.

const TRIES = 20; // frames until a button that was disabled can be focused again

let last: HTMLElement | null = null;

document.addEventListener("focusin", (event) => {
  if (event.target instanceof HTMLElement && !event.target.closest("dialog")) last = event.target;
});

/** Bring the focus back after a dialog, unless something else has it by then, as another dialog. */
export function bringFocusBack(tries = TRIES) {
  requestAnimationFrame(() => {
    const active = document.activeElement;
    if (tries === 0 || !last?.isConnected || (active !== null && active !== document.body)) return;
    last.focus();
    if (document.activeElement !== last) bringFocusBack(tries - 1);
  });
}
