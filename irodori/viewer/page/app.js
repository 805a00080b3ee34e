"use strict";
// What the scripts of the page share: the state that is shown, and what the learner has chosen beside it. What the
// learner does becomes a state (input.js, panel.js and its pages), the renderer draws it (drawing.js), controls and
// address show it (changes.js). Each script adds the functions that others call.
(function (I) {
  I.app = {
    renderer: null, // set once, by start.js
    header: null, // of the page's data
    base: null, // the page as it opens
    page: null, // {state, compare, probes, ruler, step}, see state.js
    lesson: null,
    controls: new I.Controls(), // of the panel
    tab: "lesson",
    tool: "view", // what dragging and arrow keys do
    chosenObject: 0,
    chosenLamp: 0,
    chosenNote: null,
    cursor: [0.5, 0.5], // of probe and ruler by keys, as shares of the picture
    settling: null, // timer of a change that has not come to rest
  };
})(window.Irodori);
