"use strict";
// Points of the scene on the picture and back; z is up, azimuth runs from +x towards +y.
window.Irodori = window.Irodori || {};
(function (I) {
  const RAD = Math.PI / 180;
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const along = (a, k, b) => a.map((value, i) => value + k * b[i]);
  I.distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);

  // The eye and its axes; the roll turns the camera counter-clockwise about its line of sight.
  function frame(camera) {
    const az = camera.azimuth_deg * RAD,
      el = camera.elevation_deg * RAD,
      c = Math.cos(camera.roll_deg * RAD),
      s = Math.sin(camera.roll_deg * RAD);
    const back = [Math.cos(el) * Math.cos(az), Math.cos(el) * Math.sin(az), Math.sin(el)];
    const level = [-Math.sin(az), Math.cos(az), 0];
    const upright = [-Math.sin(el) * Math.cos(az), -Math.sin(el) * Math.sin(az), Math.cos(el)];
    const right = level.map((value, i) => c * value + s * upright[i]),
      up = upright.map((value, i) => c * value - s * level[i]);
    return { back, right, up, eye: along(camera.target_mm, camera.distance_mm, back) };
  }
  I.frame = frame;

  // Rays are parallel where the picture has a height in mm; otherwise they come from the eye.
  const isParallel = (camera) => camera.height_mm > 0;
  // What a pixel spans: mm where rays are parallel, otherwise mm at a depth of 1 mm.
  I.pixel = (camera, height) =>
    (isParallel(camera) ? camera.height_mm : 2 * Math.tan((camera.fov_deg / 2) * RAD)) / height;
  const pixelAt = (camera, height, depth) => I.pixel(camera, height) * (isParallel(camera) ? 1 : depth);

  // Where a point is on a picture of this size: x, y and depth in mm; null behind the eye.
  I.project = function (camera, point, width, height) {
    const f = frame(camera);
    const d = along(point, -1, f.eye),
      depth = -dot(d, f.back);
    if (depth <= 0) return null;
    const mm = pixelAt(camera, height, depth);
    return [width / 2 + dot(d, f.right) / mm, height / 2 - dot(d, f.up) / mm, depth];
  };

  // Where the ray of a pixel meets the horizontal plane at a height; null where it does not, or too far to mean it.
  I.onPlane = function (camera, x, y, width, height, z) {
    const f = frame(camera),
      k = I.pixel(camera, height),
      parallel = isParallel(camera);
    const aside = f.right.map((value, i) => k * (value * (x - width / 2) + f.up[i] * (height / 2 - y)));
    const start = parallel ? along(f.eye, 1, aside) : f.eye,
      ray = f.back.map((value, i) => (parallel ? 0 : aside[i]) - value);
    const far = (z - start[2]) / ray[2];
    return Number.isFinite(far) && far > 0 && far < 20 * camera.distance_mm ? along(start, far, ray) : null;
  };

  // By degrees to the picture's right and up: a picture that leans is followed.
  I.orbit = function (camera, across, up) {
    const c = Math.cos(camera.roll_deg * RAD),
      s = Math.sin(camera.roll_deg * RAD),
      [azimuth, elevation] = [c * across - s * up, s * across + c * up];
    camera.azimuth_deg = ((((camera.azimuth_deg + azimuth + 180) % 360) + 360) % 360) - 180;
    camera.elevation_deg = Math.min(89, Math.max(-20, camera.elevation_deg + elevation));
  };

  I.zoom = function (camera, factor) {
    const key = isParallel(camera) ? "height_mm" : "distance_mm";
    camera[key] = Math.min(5000, Math.max(key === "height_mm" ? 1 : 20, camera[key] * factor));
  };

  // Move the target by pixels of the picture.
  I.pan = function (camera, dx, dy, height) {
    const f = frame(camera),
      k = pixelAt(camera, height, camera.distance_mm);
    camera.target_mm = along(along(camera.target_mm, -dx * k, f.right), dy * k, f.up).map((one) =>
      Math.min(5000, Math.max(-5000, one)),
    );
  };

  // Steps on the table, in mm: to the right and away from the eye.
  I.onTable = function (camera, right, away) {
    const f = frame(camera);
    // Straight down, and where the picture leans: along the picture's own sides, as far as they lie in the table.
    const flat = (v, instead) =>
      Math.hypot(v[0], v[1]) > 1e-3 ? [v[0] / Math.hypot(v[0], v[1]), v[1] / Math.hypot(v[0], v[1]), 0] : instead;
    const aside = flat(f.right, flat(f.up, [1, 0, 0]));
    return along(
      aside.map((value) => value * right),
      away,
      [-aside[1], aside[0], 0],
    );
  };

  // A camera on the way between two.
  I.between = function (a, b, t) {
    const turn = ((((b.azimuth_deg - a.azimuth_deg + 180) % 360) + 360) % 360) - 180;
    const lean = ((((b.roll_deg - a.roll_deg + 180) % 360) + 360) % 360) - 180;
    const mix = (from, to) => from + (to - from) * t;
    return {
      target_mm: a.target_mm.map((value, i) => mix(value, b.target_mm[i])),
      azimuth_deg: a.azimuth_deg + turn * t,
      elevation_deg: mix(a.elevation_deg, b.elevation_deg),
      distance_mm: a.distance_mm * (b.distance_mm / a.distance_mm) ** t,
      fov_deg: mix(a.fov_deg, b.fov_deg),
      roll_deg: a.roll_deg + lean * t,
      // Parallel rays do not become those of an eye bit by bit: the way is gone as the other sees it.
      height_mm: isParallel(a) && isParallel(b) ? mix(a.height_mm, b.height_mm) : b.height_mm,
    };
  };

  // A round length for the scale bar, at the distance of the target: mm and pixels.
  I.scaleBar = function (camera, height, longest) {
    const perMm = 1 / pixelAt(camera, height, camera.distance_mm);
    const room = longest / perMm,
      tens = 10 ** Math.floor(Math.log10(room));
    const mm = [5, 2, 1].map((one) => one * tens).find((one) => one <= room);
    return [mm, mm * perMm];
  };
})(window.Irodori);
