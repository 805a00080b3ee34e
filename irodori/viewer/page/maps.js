// Textures from planes: cube maps with their borders, atlases, trees of meshes.
"use strict";
var Irodori = Irodori || {};

(function () {
  const LARGEST = 4096,
    TRIANGLE = 7;
  Irodori.TRIANGLE = TRIANGLE; // texels of one in the texture of meshes

  // Weights of Lagrange's polynomial through eight numbers, 3 before to 4 after, at a place past 0; see scene_data.py.
  function interpolation(offset) {
    const out = [];
    for (let n = -3; n < 5; n++) {
      let weight = 1;
      for (let m = -3; m < 5; m++) if (m !== n) weight *= (offset - m) / (n - m);
      out.push(weight);
    }
    return out;
  }

  // A face of n + 8 texels a side at twice the side with a border of 1.
  function finerFace(face, width) {
    const n = width - 8,
      side = 2 * n + 2;
    const rows = new Float32Array(width * side),
      out = new Float32Array(side * side);
    const taps = [interpolation(0.25), interpolation(0.75)];
    for (let place = 0; place < side; place++) {
      const coarse = (place - 0.5) / 2 - 0.5,
        base = Math.floor(coarse),
        weights = taps[coarse - base < 0.5 ? 0 : 1];
      for (let row = 0; row < width; row++) {
        let sum = 0;
        for (let i = 0; i < 8; i++) sum += weights[i] * face[row * width + base + 1 + i];
        rows[row * side + place] = sum;
      }
    }
    for (let place = 0; place < side; place++) {
      const coarse = (place - 0.5) / 2 - 0.5,
        base = Math.floor(coarse),
        weights = taps[coarse - base < 0.5 ? 0 : 1];
      for (let column = 0; column < side; column++) {
        let sum = 0;
        for (let i = 0; i < 8; i++) sum += weights[i] * rows[(base + 1 + i) * side + column];
        out[place * side + column] = sum;
      }
    }
    return out;
  }

  const onFace = (Irodori.onFace = function (face, u, v) {
    const axis = face >> 1,
      unit = [0, 0, 0];
    unit[axis] = face & 1 ? -1 : 1;
    unit[(axis + 1) % 3] = u;
    unit[(axis + 2) % 3] = v;
    return unit;
  });

  const lookUp = (Irodori.lookUpCube = function (map, width, side, unit, reach) {
    const a = unit.map(Math.abs),
      axis = a[0] >= a[1] && a[0] >= a[2] ? 0 : a[1] >= a[2] ? 1 : 2;
    const face = 2 * axis + (unit[axis] < 0 ? 1 : 0);
    const place = [1, 2].map((i) => {
      const p = ((unit[(axis + i) % 3] / a[axis] + 1) * side) / 2 + 0.5;
      return Math.min(Math.max(p, 1 - reach), side + reach);
    });
    const column = Math.min(Math.floor(place[0]), side),
      row = Math.min(Math.floor(place[1]), side);
    const fx = place[0] - column,
      fy = place[1] - row,
      at = (face * width + row) * width + column;
    return (
      (map[at] * (1 - fx) + map[at + 1] * fx) * (1 - fy) + (map[at + width] * (1 - fx) + map[at + width + 1] * fx) * fy
    );
  });

  // Fill the border of one texel of six faces from what the other faces show there.
  function fillBorders(map, side) {
    const width = side + 2,
      place = (i) => (2 * (i - 0.5)) / side - 1,
      found = [];
    for (let face = 0; face < 6; face++) {
      for (let row = 0; row < width; row++) {
        for (let column = 0; column < width; column++) {
          const atRow = row === 0 || row === width - 1,
            atColumn = column === 0 || column === width - 1;
          if (!atRow && !atColumn) continue;
          const unit = onFace(face, place(column), place(row));
          let value = 0;
          if (atRow && atColumn) {
            for (const turn of [1, 2]) {
              const other = ((face >> 1) + turn) % 3,
                beside = unit.slice();
              beside[other] = Math.sign(beside[other]) * Math.abs(unit[face >> 1]);
              value += 0.5 * lookUp(map, width, side, beside, 0);
            }
          } else value = lookUp(map, width, side, unit, 0);
          found.push([(face * width + row) * width + column, value]);
        }
      }
    }
    for (const [at, value] of found) map[at] = value;
  }

  // An environment and its halvings: levels of {side, channels: [six faces with border]}.
  function skyLevels(plane, channels, side) {
    const bordered = (inner, s) => {
      const map = new Float32Array(6 * (s + 2) * (s + 2));
      for (let face = 0; face < 6; face++)
        for (let row = 0; row < s; row++)
          map.set(
            inner.subarray((face * s + row) * s, (face * s + row + 1) * s),
            (face * (s + 2) + row + 1) * (s + 2) + 1,
          );
      fillBorders(map, s);
      return map;
    };
    let inner = Array.from({ length: channels }, (_, c) =>
      plane.subarray(c * 6 * side * side, (c + 1) * 6 * side * side),
    );
    const levels = [];
    for (;;) {
      levels.push({ side, channels: inner.map((values) => bordered(values, side)) });
      if (side % 2 || side / 2 < 4) return levels;
      const half = side / 2,
        from = side;
      inner = inner.map((values) => {
        const out = new Float32Array(6 * half * half);
        for (let face = 0; face < 6; face++)
          for (let row = 0; row < half; row++)
            for (let column = 0; column < half; column++) {
              const at = (face * from + 2 * row) * from + 2 * column;
              out[(face * half + row) * half + column] =
                0.25 * (values[at] + values[at + 1] + values[at + from] + values[at + from + 1]);
            }
        return out;
      });
      side = half;
    }
  }

  // A map with its border, or at half its side with one of 4.
  function level(plane, channels, side) {
    const width = Math.round(Math.sqrt(plane.length / channels / 6)),
      size = 6 * width * width;
    return {
      side,
      channels: Array.from({ length: channels }, (_, c) => {
        const own = plane.subarray(c * size, (c + 1) * size);
        if (width === side + 2) return own;
        const out = new Float32Array(6 * (side + 2) * (side + 2));
        for (let face = 0; face < 6; face++)
          out.set(
            finerFace(own.subarray(face * width * width, (face + 1) * width * width), width),
            face * (side + 2) * (side + 2),
          );
        return out;
      }),
    };
  }

  // Places of rectangles in an atlas, row by row; [{x, y}], width and height.
  function packed(sizes) {
    const widest = Math.min(
      Math.max(
        512,
        ...sizes.map((s) => s[0]),
        Math.ceil(Math.sqrt(sizes.reduce((sum, s) => sum + s[0] * s[1], 0)) * 1.2),
      ),
      LARGEST,
    );
    let x = 0,
      y = 0,
      high = 0,
      width = 0;
    const places = sizes.map(([w, h]) => {
      if (x + w > widest) [x, y, high] = [0, y + high, 0];
      const place = { x, y };
      x += w;
      high = Math.max(high, h);
      width = Math.max(width, x);
      return place;
    });
    if (width > LARGEST || y + high > LARGEST)
      throw new Error(
        "The data of this page: found maps larger than a texture; accepted: up to " + LARGEST + " texels a side.",
      );
    return { places, width, height: y + high };
  }

  // Levels of cube maps in one atlas of groups of four channels; faces in three columns and two rows.
  Irodori.cubeAtlas = function (levels, scale) {
    const { places, width, height } = packed(levels.map((l) => [3 * (l.side + 2), 2 * (l.side + 2)]));
    const groups = Math.ceil(levels[0].channels.length / 4),
      out = new Float32Array(groups * width * height * 4);
    levels.forEach((one, number) => {
      const w = one.side + 2,
        { x, y } = places[number];
      one.channels.forEach((values, c) => {
        const layer = (c >> 2) * width * height;
        for (let face = 0; face < 6; face++)
          for (let row = 0; row < w; row++) {
            let at = 4 * (layer + (y + Math.floor(face / 3) * w + row) * width + x + (face % 3) * w) + (c & 3);
            for (let column = 0; column < w; column++, at += 4)
              out[at] = values[(face * w + row) * w + column] / scale[c];
          }
      });
    });
    return {
      data: out,
      width,
      height,
      layers: groups,
      origins: levels.map((l, i) => [places[i].x, places[i].y, l.side]),
    };
  };

  // Powers of two that bring the largest number of each channel into half precision.
  Irodori.halfScale = function (levels) {
    return levels[0].channels.map((_, c) => {
      let most = 0;
      for (const one of levels) for (const value of one.channels[c]) most = Math.max(most, Math.abs(value));
      return most > 0 ? Math.pow(2, Math.ceil(Math.log2(most)) - 15) : 1;
    });
  };

  Irodori.lightLevels = function (data, number) {
    const entry = data.header.light[number],
      name = "light/" + number + "/",
      shape = data.shapes[name + "sky"];
    const k = shape[0];
    return {
      sky: skyLevels(data.planes[name + "sky"], k, shape[2]),
      // Without a coat, then under each of the scene's coats.
      irradiance: ["irradiance", ...data.header.coats.map((_, coat) => "irradiance/" + coat)].map((own) =>
        level(data.planes[name + own], k, data.shapes[name + own][2] - 2),
      ),
      gloss: entry.gloss_sides.map((side, i) => level(data.planes[name + "gloss/" + i], k, side)),
    };
  };

  // Materials of all surfaces with their borders: coefficients, then power and place of two lobes, then what is known.
  Irodori.materialAtlas = function (data, widest) {
    const objects = Irodori.surfaces(data.header),
      groups = Math.ceil(widest / 4);
    const { places, width, height } = packed(objects.map((o) => [o.texels[1] + 2, o.texels[0] + 2]));
    const layers = groups + 2,
      out = new Float32Array(layers * width * height * 4);
    let power = 0;
    const plane = (i, name) => data.planes["object/" + i + "/" + name];
    objects.forEach((o, i) =>
      o.lobes.forEach((_, c) => plane(i, "power/" + c).forEach((x) => (power = Math.max(power, x)))),
    );
    const scale = power > 0 ? 1024 / power : 1;
    objects.forEach((o, i) => {
      const [rows, columns] = o.texels,
        { x, y } = places[i];
      const put = (layer, channel, values, factor) => {
        for (let r = 0; r < rows + 2; r++)
          for (let c = 0; c < columns + 2; c++) {
            const row = Math.min(Math.max(r - 1, 0), rows - 1);
            const column = o.wraps ? (c - 1 + columns) % columns : Math.min(Math.max(c - 1, 0), columns - 1);
            out[4 * ((layer * height + y + r) * width + x + c) + channel] = factor * values[row * columns + column];
          }
      };
      const texels = rows * columns;
      for (let j = 0; j < o.bases; j++)
        put(j >> 2, j & 3, plane(i, "reflectance").subarray(j * texels, (j + 1) * texels), 1);
      o.lobes.forEach((_, c) => {
        put(groups, 2 * c, plane(i, "power/" + c), scale);
        put(groups, 2 * c + 1, plane(i, "place/" + c), 1);
      });
      if (!plane(i, "status")) return; // of a transmittance
      put(groups + 1, 0, plane(i, "status"), 1);
      put(groups + 1, 1, plane(i, "uncertainty"), 1);
    });
    return { data: out, width, height, layers, places, scale };
  };

  // A tree of boxes over triangles, in the order in which it is passed; each node knows where to go on beside it.
  function tree(triangles, centres, boxes) {
    const order = Array.from({ length: triangles }, (_, i) => i),
      nodes = [];
    const build = (first, last) => {
      const low = [Infinity, Infinity, Infinity],
        high = [-Infinity, -Infinity, -Infinity];
      const clow = low.slice(),
        chigh = high.slice();
      for (let i = first; i < last; i++)
        for (let a = 0; a < 3; a++) {
          low[a] = Math.min(low[a], boxes[6 * order[i] + a]);
          high[a] = Math.max(high[a], boxes[6 * order[i] + 3 + a]);
          clow[a] = Math.min(clow[a], centres[3 * order[i] + a]);
          chigh[a] = Math.max(chigh[a], centres[3 * order[i] + a]);
        }
      const number = nodes.push({ low, high, skip: 0, leaf: -1 }) - 1;
      const size = clow.map((x, a) => chigh[a] - x),
        axis = size.indexOf(Math.max(...size));
      if (last - first <= 4) nodes[number].leaf = 8 * first + last - first;
      else {
        const cut = 0.5 * (clow[axis] + chigh[axis]);
        let middle = first;
        for (let i = first; i < last; i++)
          if (centres[3 * order[i] + axis] < cut) {
            [order[i], order[middle]] = [order[middle], order[i]];
            middle++;
          }
        if (middle === first || middle === last) middle = (first + last) >> 1;
        build(first, middle);
        build(middle, last);
      }
      nodes[number].skip = nodes.length;
    };
    build(0, triangles);
    return { nodes, order };
  }

  // The nodes at the places of the meshes' triangles, between which light is interpolated, four a texel of 2048
  // columns; and by which traced nodes each is lit, where not all are. Null where no mesh has a light map.
  Irodori.cornerTexture = function (data) {
    const places = {};
    let total = 0;
    data.header.objects.forEach((o, i) => {
      const plane = (name) => data.planes["object/" + i + "/map/" + name],
        parts = plane("parts"),
        starts = [];
      if (!parts) return;
      for (let t = 0, start = 0; t < parts.length; t++) {
        starts.push(start);
        start += ((parts[t] + 1) * (parts[t] + 2)) / 2;
      }
      const nodes = plane("corners"),
        near = plane("near");
      places[i] = { first: total, parts, starts, nodes, near, share: plane("share"), count: o.map.columns };
      total += nodes.length;
    });
    if (!total) return null;
    const rows = Math.ceil(total / 4 / 2048),
      out = new Float32Array(4 * 2048 * rows);
    if (rows > LARGEST)
      throw new Error("The data of this page: found " + total + " nodes; accepted: as many as fit in a texture.");
    for (const one of Object.values(places)) out.set(one.nodes, one.first);
    return { data: out, width: 2048, height: rows, places };
  };

  // Meshes of all objects in one texture of 2048 columns: nodes of all, two texels each; then triangles: three corners,
  // three normals, and where their places among the nodes begin and in how many parts their edges are divided.
  Irodori.meshTexture = function (data, corners) {
    const found = [];
    data.header.objects.forEach((o, i) => {
      if (o.shape !== "mesh") return;
      const plane = (name) => data.planes["object/" + i + "/mesh/" + name];
      const faces = plane("faces"),
        points = plane("vertices"),
        n = points.length / 3,
        m = faces.length / 3;
      const corner = (t, c) => faces[c * m + t],
        at = (values, vertex, axis) => values[axis * n + vertex];
      const centres = new Float64Array(3 * m),
        boxes = new Float64Array(6 * m);
      for (let t = 0; t < m; t++)
        for (let a = 0; a < 3; a++) {
          const p = [0, 1, 2].map((c) => at(points, corner(t, c), a));
          centres[3 * t + a] = (p[0] + p[1] + p[2]) / 3;
          boxes[6 * t + a] = Math.min(...p);
          boxes[6 * t + 3 + a] = Math.max(...p);
        }
      found.push({ object: i, corner, at, plane, m, ...tree(m, centres, boxes) });
    });
    if (!found.length) return null;
    const nodes = found.reduce((sum, f) => sum + f.nodes.length, 0),
      triangles = found.reduce((sum, f) => sum + f.m, 0);
    const texels = 2 * nodes + TRIANGLE * triangles,
      rows = Math.ceil(texels / 2048),
      out = new Float32Array(4 * 2048 * rows);
    if (rows > LARGEST)
      throw new Error(
        "The data of this page: found " + triangles + " triangles; accepted: as many as fit in a texture.",
      );
    let node = 0,
      triangle = 0;
    const places = {};
    for (const f of found) {
      const { low, high } = f.nodes[0];
      places[f.object] = {
        first: node,
        last: node + f.nodes.length,
        triangles: 2 * nodes + TRIANGLE * triangle,
        order: f.order,
        low,
        high,
      };
      f.nodes.forEach((one, i) => out.set([...one.low, node + one.skip, ...one.high, one.leaf], 8 * (node + i)));
      f.order.forEach((t, place) => {
        const to = 4 * (2 * nodes + TRIANGLE * (triangle + place)),
          uv = f.plane("uv"),
          normals = f.plane("normals"),
          points = f.plane("vertices");
        const uvs = [0, 1, 2].flatMap((c) => [0, 1].map((a) => f.at(uv, f.corner(t, c), a)));
        for (let c = 0; c < 3; c++)
          for (let a = 0; a < 3; a++) {
            out[to + 4 * c + a] = f.at(points, f.corner(t, c), a);
            out[to + 12 + 4 * c + a] = f.at(normals, f.corner(t, c), a);
          }
        uvs.forEach((x, i) => (out[to + 4 * i + 3] = x));
        const own = corners && corners.places[f.object];
        if (own) out.set([own.first + own.starts[t], own.parts[t]], to + 24);
      });
      node += f.nodes.length;
      triangle += f.m;
    }
    return { data: out, width: 2048, height: rows, places };
  };
})();
