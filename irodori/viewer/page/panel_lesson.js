"use strict";
// The panel's page of the lesson: its steps for the learner, and the fields by which a teacher writes them.
(function (I) {
  const app = I.app,
    h = I.h,
    $ = I.byId;
  let teaching = false;

  const paragraphs = (words) =>
    words
      .trim()
      .split(/\n\s*\n/)
      .map((one) => h("p", {}, one.replace(/\s*\n\s*/g, " ")));

  function lessonPage() {
    if (!app.lesson) return [h("p", { class: "hint", text: "no_lesson" }), teacherGroup()];
    const at = app.page.step,
      one = at === null ? null : app.lesson.steps[at],
      count = app.lesson.steps.length;
    // Words that the teacher changes in the fields below.
    const worded = (element, show) => {
      app.controls.updates.push(show);
      show();
      return element;
    };
    const title = h("p", { class: "lesson-title" });
    const parts = [
      worded(title, () => {
        title.textContent = I.inLanguage(app.lesson.title);
      }),
    ];
    if (one) {
      const heading = h("h2", { class: "step-title" }),
        prose = h("div", { class: "prose" }),
        notes = h("ol", { class: "noted" });
      parts.push(
        worded(heading, () => {
          heading.textContent = I.inLanguage(one.title);
        }),
        prose,
      );
      const text = h("div", { class: "prose" });
      prose.append(
        worded(text, () => {
          text.replaceChildren(...paragraphs(I.inLanguage(one.text)));
        }),
      );
      if (one.picture)
        prose.append(
          h("img", { src: one.picture, alt: I.text("picture_of_step", { title: I.inLanguage(one.title) }) }),
        );
      if (one.notes?.length)
        prose.append(
          worded(notes, () => {
            notes.replaceChildren(...one.notes.map((note) => h("li", {}, I.inLanguage(note.text))));
          }),
        );
    }
    if (count)
      parts.push(
        h(
          "div",
          { class: "stepper" },
          app.controls.button("previous", () => stepTo((at ?? 0) - 1, ".stepper button:first-child"), {
            disabled: at === null || at === 0,
          }),
          h("span", {}, at === null ? I.text("step_count", { count }) : I.text("step_of", { number: at + 1, count })),
          app.controls.button(
            at === null ? "begin" : "next",
            () => stepTo(at === null ? 0 : at + 1, ".stepper button:last-child"),
            { class: "chief", disabled: at === count - 1 },
          ),
        ),
      );
    parts.push(
      h(
        "ol",
        { class: "steps" },
        ...app.lesson.steps.map((step, i) => {
          const button = h("button", {
            type: "button",
            "data-number": i + 1,
            "aria-current": i === at ? "step" : null,
            on: { click: () => stepTo(i, `.steps li:nth-child(${i + 1}) button`) },
          });
          return h(
            "li",
            {},
            worded(button, () => {
              button.textContent = I.inLanguage(step.title);
            }),
          );
        }),
      ),
    );
    parts.push(teacherGroup());
    return parts;
  }

  function stepTo(index, focus) {
    app.goTo(index);
    const again = document.querySelector(focus);
    (again && !again.disabled ? again : document.querySelector(`.steps li:nth-child(${index + 1}) button`))?.focus({
      preventScroll: true,
    });
    if ($("live")) $("live").textContent = I.inLanguage(app.lesson.steps[index].title);
  }

  function teacherGroup() {
    const group = h("section", { class: "group" }, h("h2", { text: "for_teachers" }));
    if (!teaching) {
      group.append(
        app.controls.button("edit_lesson", () => {
          teaching = true;
          app.lesson ??= { title: { [I.language()]: app.header.title }, steps: [] };
          app.rebuild("#step-title");
        }),
      );
      return group;
    }
    const code = I.language(),
      at = app.page.step,
      one = at === null ? null : app.lesson.steps[at];
    const field = (id, key, element, value, take) => {
      element.id = id;
      element.value = value;
      element.addEventListener("input", () => take(element.value));
      return h("div", { class: "control" }, h("label", { for: id, class: "named", text: key }), element);
    };
    const text = () => h("input", { type: "text", maxlength: 200 });
    const written = (texts) => (words) => {
      if (words.trim()) texts[code] = words.trim();
      app.controls.update();
      app.showNotes();
      app.layMarks();
    };
    group.append(
      h("p", { class: "hint", text: "teacher_hint" }),
      field("lesson-title", "lesson_title", text(), app.lesson.title[code] ?? "", written(app.lesson.title)),
    );
    if (one)
      group.append(
        field("step-title", "step_title", text(), one.title[code] ?? "", written(one.title)),
        field("step-text", "step_text", h("textarea", { maxlength: 4000 }), one.text[code] ?? "", written(one.text)),
        h(
          "div",
          { class: "row" },
          app.controls.button("step_takes_picture", () => {
            app.lesson.steps[at] = I.stepOfPage(app.page, one, app.base);
            app.rebuild();
            app.say(I.text("step_taken", { number: at + 1 }));
          }),
          app.controls.button(
            "note_here",
            () => {
              if (!app.page.probes.length) return app.say(I.text("probe_first"));
              (one.notes ??= []).push({
                position_mm: app.page.probes.at(-1).position_mm.map((value) => Math.round(value * 10) / 10),
                text: { [code]: I.text("new_note") },
              });
              return app.rebuild("#note-" + (one.notes.length - 1));
            },
            { disabled: (one.notes?.length ?? 0) >= 20 },
          ),
          app.controls.button("step_picture", () => app.askFile(app.takePicture)),
          ...(one.picture
            ? [
                app.controls.button("remove_picture", () => {
                  for (const key of ["picture", "picture_file", "given_here"]) delete one[key];
                  app.rebuild("#step-title");
                }),
              ]
            : []),
        ),
        ...(one.notes ?? []).map((note, i) =>
          h(
            "div",
            {},
            field("note-" + i, "note_text", text(), note.text[code] ?? "", written(note.text)),
            app.controls.button("remove_note", () => {
              one.notes.splice(i, 1);
              app.rebuild("#step-title");
            }),
          ),
        ),
        h(
          "div",
          { class: "row" },
          app.controls.button("earlier", () => moveStep(at, -1), { disabled: at === 0 }),
          app.controls.button("later", () => moveStep(at, 1), { disabled: at === app.lesson.steps.length - 1 }),
          app.controls.button("remove_step", () => {
            app.lesson.steps.splice(at, 1);
            app.page.step = null;
            app.rebuild("#add-step");
          }),
        ),
      );
    group.append(
      app.controls.button(
        "add_step",
        () => {
          const words = { title: { [code]: I.text("new_step") }, text: { [code]: I.text("new_text") } };
          app.lesson.steps.push(I.stepOfPage(app.page, words, app.base));
          app.page.step = app.lesson.steps.length - 1;
          app.rebuild("#step-title");
        },
        { id: "add-step", disabled: app.lesson.steps.length >= 100 },
      ),
      app.controls.button("export_lesson", exportLesson, { disabled: !app.lesson.steps.length }),
    );
    return group;
  }

  function exportLesson() {
    app.save(new Blob([I.lessonYaml(app.lesson)], { type: "text/yaml" }), `${app.header.scene}-lesson.yaml`);
    const pictures = I.givenPictures(app.lesson);
    for (const [name, address] of pictures) {
      const bytes = Uint8Array.from(atob(address.split(",")[1]), (letter) => letter.charCodeAt(0));
      app.save(new Blob([bytes], { type: address.slice(5, address.indexOf(";")) }), name);
    }
    if (pictures.length) app.say(I.text("pictures_exported", { files: pictures.map(([name]) => name).join(", ") }));
  }

  function moveStep(at, by) {
    const [one] = app.lesson.steps.splice(at, 1);
    app.lesson.steps.splice(at + by, 0, one);
    app.page.step = at + by;
    app.rebuild("#step-title");
  }

  Object.assign(app, { lessonPage });
})(window.Irodori);
