"use strict";
// Files: pictures and lessons that are saved, tables of light, profiles and pictures that are opened or dropped.
(function (I) {
  const app = I.app,
    h = I.h,
    $ = I.byId,
    canvas = $("picture");
  let fileTaker = (file) => takeFile(file, null);

  function save(blob, name) {
    const link = h("a", { href: URL.createObjectURL(blob), download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  function snapshot() {
    app.renderer.draw(app.page.state, { compare: app.page.compare, scale: 1 });
    canvas.toBlob(async (blob) => {
      if (!blob) return app.say(I.text("no_picture"));
      const bytes = new Uint8Array(await blob.arrayBuffer());
      return save(
        new Blob([I.pngWithText(bytes, I.pageToHash(app.page, app.base))], { type: "image/png" }),
        `${app.header.scene}.png`,
      );
    }, "image/png");
  }

  // Ask for a file, and give it to a function.
  function askFile(taker) {
    fileTaker = taker;
    $("file").value = "";
    $("file").click();
  }

  function takePicture(file) {
    const step = app.lesson.steps[app.page.step];
    return reading(async () => {
      I.givePicture(app.lesson, step, new Uint8Array(await file.slice(0, I.MOST_PICTURE + 1).arrayBuffer()), file.name);
      app.rebuild("#step-title");
    });
  }

  function takeFile(file, taker) {
    return reading(async () => {
      if (file.size > 50e6) throw new I.Refusal("file_too_large", { file: file.name });
      if (/\.png$/i.test(file.name)) {
        const bytes = new Uint8Array(await file.arrayBuffer());
        app.put(I.hashToPage(I.textOfPng(bytes), app.base, app.header, app.lesson), true);
        app.say(I.text("snapshot_opened"));
      } else if (/\.(csv|txt|tsv)$/i.test(file.name)) {
        const power = I.powerOfTable(await file.text(), file.name);
        (
          taker ??
          ((one) => {
            app.page.state.light.illuminant = one;
          })
        )(power);
        app.rebuild();
        app.say(I.text("light_taken", { file: file.name }));
      } else if (/\.(icc|icm)$/i.test(file.name)) {
        app.page.state.display = I.screenOfProfile(new Uint8Array(await file.arrayBuffer()), file.name);
        app.rebuild();
        app.say(I.text("profile_taken", { file: file.name }));
      } else throw new I.Refusal("file_unknown", { file: file.name });
    });
  }

  // As `tell`, of what takes its time.
  async function reading(act) {
    try {
      await act();
    } catch (error) {
      if (!(error instanceof I.Refusal)) throw error;
      app.say(I.sentence(error));
    }
  }

  $("file").addEventListener("change", () => {
    if ($("file").files[0]) fileTaker($("file").files[0]);
  });
  document.addEventListener("dragover", (event) => event.preventDefault());
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    if (app.page && event.dataTransfer.files[0]) takeFile(event.dataTransfer.files[0], null);
  });

  Object.assign(app, { save, snapshot, askFile, takePicture, takeFile });
})(window.Irodori);
