// Names in a picture that would lie over each other, or under its buttons, are moved apart.

import { Vector3, type Camera, type Object3D, type Sprite } from "three";

interface Box {
  left: number; // CSS px from the picture's upper left corner
  right: number;
  top: number;
  bottom: number;
}

const BUTTONS = { wide: 128, high: 68 }; // CSS px, in the lower right corner
const MOST_MOVES = 12;

/** Move each name up as far as it takes; the lowest one stays where it belongs. */
export function spreadNames(root: Object3D, camera: Camera, width_px: number, high_px: number) {
  const taken: Box[] = [{ left: width_px - BUTTONS.wide, right: width_px, top: high_px - BUTTONS.high, bottom: high_px }];
  const names: { sprite: Sprite; box: Box }[] = [];
  root.traverse((part) => {
    if (!part.visible || !(part as Sprite).isSprite || !part.userData["name"]) return;
    const sprite = part as Sprite;
    names.push({ sprite, box: boxOf(sprite, camera, width_px, high_px) });
  });
  names.sort((one, other) => other.box.bottom - one.box.bottom);
  for (const { sprite, box } of names) {
    let up = 0;
    for (let moves = 0; moves < MOST_MOVES; moves++) {
      const hidden = taken.find((other) => overlap(box, other, up));
      if (!hidden) break;
      up = box.bottom - hidden.top;
    }
    taken.push({ ...box, top: box.top - up, bottom: box.bottom - up });
    sprite.center.y = sprite.userData["center_y"] - up / sprite.userData["high_px"];
  }
}

function boxOf(sprite: Sprite, camera: Camera, width_px: number, high_px: number): Box {
  const at = sprite.getWorldPosition(new Vector3()).project(camera);
  const { high_px: high, aspect, center_y } = sprite.userData;
  const left = ((at.x + 1) / 2) * width_px - sprite.center.x * high * aspect;
  const bottom = ((1 - at.y) / 2) * high_px + center_y * high;
  return { left, right: left + high * aspect, top: bottom - high, bottom };
}

const overlap = (box: Box, other: Box, up: number): boolean =>
  box.left < other.right && other.left < box.right && box.top - up < other.bottom && other.top < box.bottom - up;
