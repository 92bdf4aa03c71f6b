"use strict";
// The divider between two pictures of a stage, by pointer and by keyboard.
const Stage = (() => {
  function moveTo(stage, percent) {
    const split = Math.min(100, Math.max(0, percent));
    stage.style.setProperty("--split", `${split}%`);
    const input = stage.querySelector("input");
    input.value = Math.round(split);
    input.setAttribute("aria-valuetext", `${Math.round(split)} % ${stage.querySelector(".left").textContent}`);
    stage.querySelector(".left").classList.toggle("faint", split < 12);
    stage.querySelector(".right").classList.toggle("faint", split > 88);
  }

  function dragged(stage, event) {
    const box = stage.getBoundingClientRect();
    moveTo(stage, (100 * (event.clientX - box.left)) / box.width);
  }

  function setUpStage(stage) {
    const input = stage.querySelector("input");
    let dragging = false;
    stage.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      dragging = true;
      stage.setPointerCapture(event.pointerId);
      input.focus({ preventScroll: true, focusVisible: false });
      // A finger may be about to scroll: it moves the divider only once it moves sideways.
      if (event.pointerType !== "touch") dragged(stage, event);
      if (event.pointerType === "mouse") event.preventDefault();
    });
    stage.addEventListener("pointermove", (event) => dragging && dragged(stage, event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      stage.addEventListener(end, () => { dragging = false; });
    }
    stage.addEventListener("click", (event) => event.detail > 0 && dragged(stage, event));
    input.addEventListener("input", () => moveTo(stage, Number(input.value)));
    moveTo(stage, Number(input.value));
  }

  return { moveTo, setUpStage };
})();
