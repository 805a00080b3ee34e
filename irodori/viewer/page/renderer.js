// The renderer: a scene's textures, two programs, and frames of a state; the state is told in docs/viewer.md.
"use strict";
var Irodori = Irodori || {};

(function () {
  // Directions to a ball of light: few where it is seen whole, many where something hides a part of it.
  const MOST_LAMPS = (Irodori.LAMPS = 8), // also MOST_LAMPS in irodori/config/pages.py
    FEW = 16,
    MANY = 512,
    ROW = 12;
  const KINDS = { sphere: 0, plate: 1, disc: 2, plane: 3, mesh: 4 };
  const TEXTURES = "uShapes uForms uMaterials uSky uIrradiance uGloss uRows uMesh uCorners uLight".split(" ");
  // Light maps: with every so many texels along a side, and cells; how many are kept.
  const COARSE = [2, 2],
    FINE = [1, 1],
    KEPT = 6;
  const OVERLAYS = [null, "status", "uncertainty", "gamut"],
    MODES = [null, "wipe", "difference", "metamerism"];
  const radians = (x) => (x * Math.PI) / 180;

  // World from object, rows, of turns about x, then y, then z.
  const turned = (Irodori.turned = function (degrees) {
    const [a, b, c] = degrees.map(radians),
      m = (rows) => rows;
    const x = m([
      [1, 0, 0],
      [0, Math.cos(a), -Math.sin(a)],
      [0, Math.sin(a), Math.cos(a)],
    ]);
    const y = m([
      [Math.cos(b), 0, Math.sin(b)],
      [0, 1, 0],
      [-Math.sin(b), 0, Math.cos(b)],
    ]);
    const z = m([
      [Math.cos(c), -Math.sin(c), 0],
      [Math.sin(c), Math.cos(c), 0],
      [0, 0, 1],
    ]);
    return Irodori.product(z, Irodori.product(y, x));
  });

  // Columns of a matrix of rows, as WebGL wants them.
  const columns = (m) => [0, 1, 2].flatMap((c) => m.map((row) => row[c]));

  Irodori.Renderer = class {
    constructor(canvas, data) {
      this.canvas = canvas;
      this.data = data;
      this.spectra = new Irodori.Spectra(data);
      this.onlost = this.onrestored = null;
      this.lost = false;
      this.linked = { milliseconds: 0 };
      this.times = [];
      canvas.addEventListener("webglcontextlost", (event) => {
        event.preventDefault();
        this.lost = true;
        if (this.onlost) this.onlost();
      });
      canvas.addEventListener("webglcontextrestored", () => {
        this.ready = this.prepare().then(() => {
          this.lost = false;
          if (this.onrestored) this.onrestored();
        });
        this.ready.catch(() => 0);
      });
      this.ready = this.prepare();
    }

    async prepare() {
      const gl = (this.gl = this.canvas.getContext("webgl2", {
        antialias: false,
        alpha: false,
        preserveDrawingBuffer: true,
        powerPreference: "high-performance",
      }));
      if (!gl) throw new Irodori.Refusal("no_webgl2");
      if (!gl.getExtension("EXT_color_buffer_float")) throw new Irodori.Refusal("no_float_buffers");
      this.parallel = gl.getExtension("KHR_parallel_shader_compile");
      this.targets = {};
      this.lights = [];
      this.screenKey = null;
      this.textures = {};
      this.vertices = gl.createVertexArray();
      this.lit = null;
      this.coloured = this.data.header.quadrature !== null;
      this.makeMaterials();
      const corners = Irodori.cornerTexture(this.data),
        mesh = Irodori.meshTexture(this.data, corners);
      this.meshes = mesh ? mesh.places : {};
      this.maps = this.data.header.ambient ? new Irodori.LightMaps(this.data, this.spectra, mesh, corners) : null;
      this.baked = new Map();
      if (corners) this.textures.uCorners = this.texture(corners, gl.RGBA32F, gl.RGBA, gl.FLOAT, gl.NEAREST);
      if (mesh) this.textures.uMesh = this.texture(mesh, gl.RGBA32F, gl.RGBA, gl.FLOAT, gl.NEAREST);
      this.makeLobes();
      this.programs = {};
      this.programs.display = await this.program("display", Irodori.sources["display.glsl"], "");
      const lights = this.data.header.light.map((_, number) => this.makeLight(number));
      // Rooms of a kind share a program.
      for (const light of lights) {
        const defines = this.defines(light),
          same = lights.find((one) => one.program && one.program.defines === defines);
        light.program = same
          ? same.program
          : await this.program("transport", Irodori.sources["transport.glsl"], defines);
      }
      this.lights = lights;
    }

    // A texture of {data, width, height, layers}.
    texture(image, internal, format, type, filter) {
      const gl = this.gl,
        target = image.layers ? gl.TEXTURE_2D_ARRAY : gl.TEXTURE_2D,
        texture = gl.createTexture();
      gl.bindTexture(target, texture);
      gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
      if (image.layers)
        gl.texImage3D(target, 0, internal, image.width, image.height, image.layers, 0, format, type, image.data);
      else gl.texImage2D(target, 0, internal, image.width, image.height, 0, format, type, image.data);
      for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, name, filter);
      for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(target, name, gl.CLAMP_TO_EDGE);
      return { texture, target };
    }

    half(image) {
      return this.texture(image, this.gl.RGBA16F, this.gl.RGBA, this.gl.FLOAT, this.gl.LINEAR);
    }

    makeMaterials() {
      this.atlas = Irodori.materialAtlas(this.data, this.spectra.widest);
      this.textures.uMaterials = this.half(this.atlas);
      this.atlas.data = null;
    }

    makeLobes() {
      const { lobes } = this.data.header,
        gl = this.gl,
        tables = lobes.map((_, i) => this.data.shapes["lobe/" + i]);
      this.parts = 0;
      if (!tables.length || !tables[0]) return;
      this.parts = Math.max(...tables.map((shape) => shape[0]));
      const each = 17 * 17 * 16,
        out = new Float32Array(lobes.length * this.parts * each);
      lobes.forEach((_, i) => out.set(this.data.planes["lobe/" + i], i * this.parts * each));
      this.textures.uRows = this.texture(
        { data: out, width: 68, height: 17 * this.parts * lobes.length },
        gl.RGBA32F,
        gl.RGBA,
        gl.FLOAT,
        gl.NEAREST,
      );
    }

    // Maps of the light of an environment.
    makeLight(number) {
      const entry = this.data.header.light[number],
        scale = [1, 1, 1, 1],
        light = { number, textures: {}, sky: [], gloss: [], scale, first: entry.gloss_first, irradiance: [] };
      if (entry.is_dark) return light;
      const levels = Irodori.lightLevels(this.data, number);
      light.scale = Irodori.halfScale([...levels.sky.slice(0, 1), ...levels.irradiance, ...levels.gloss]);
      const map = (name, some) => {
        const made = Irodori.cubeAtlas(some, light.scale);
        light.textures[name] = this.half(made);
        return made.origins;
      };
      light.sky = map("uSky", levels.sky);
      light.irradiance = map("uIrradiance", levels.irradiance);
      if (levels.gloss.length) light.gloss = map("uGloss", levels.gloss);
      return light;
    }

    defines(light) {
      const header = this.data.header,
        has = (kind) => Number(header.objects.some((o) => o.shape === kind));
      const k = this.spectra.lights[light.number].basis.length;
      const ggx = header.lobes.map((lobe, i) => (lobe.name === "ggx" ? "(l) == " + i : null)).filter(Boolean);
      const values = {
        OBJECTS: header.objects.length,
        SURFACES: header.objects.length + header.sides.length,
        SHEETS: Number(header.sides.length > 0),
        COATS: header.coats.length,
        K: k,
        G: Math.ceil(k / 4),
        KS: this.spectra.widest,
        BOUNCES: header.max_bounces,
        BAKED: Number(header.ambient),
        SEES: Number(header.ambient && this.parts > 0),
        WIDE: this.coloured ? 4 : this.spectra.widest,
        COLOURED: Number(this.coloured),
        HAS_LIGHT: Number(light.sky.length > 0),
        SKY_LEVELS: light.sky.length,
        GLOSS_LEVELS: light.gloss.length,
        PARTS: this.parts,
        LOBES: Math.max(header.lobes.length, 1),
        HAS_MESH: has("mesh"),
        TRIANGLE: Irodori.TRIANGLE,
        MOST_LAMPS,
        FEW,
        MANY,
        "GGX(l)": ggx.length ? "(" + ggx.join(" || ") + ")" : "false",
      };
      return Object.entries(values)
        .map(([name, value]) => "#define " + name + " " + value + "\n")
        .join("");
    }

    // Compile and link without waiting in the browser's way, where it can do that beside the page.
    async program(name, source, defines) {
      const gl = this.gl,
        start = performance.now(),
        program = gl.createProgram();
      const corner =
        "void main() { vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);" +
        " gl_Position = vec4(corner, 0.0, 1.0); }";
      const shaders = [
        [gl.VERTEX_SHADER, corner],
        [gl.FRAGMENT_SHADER, defines + source],
      ].map(([type, text]) => {
        const shader = gl.createShader(type);
        gl.shaderSource(shader, "#version 300 es\n" + text);
        gl.compileShader(shader);
        gl.attachShader(program, shader);
        return shader;
      });
      gl.linkProgram(program);
      if (this.parallel)
        while (!gl.getProgramParameter(program, this.parallel.COMPLETION_STATUS_KHR) && !gl.isContextLost())
          await new Promise((go) => setTimeout(go, 4));
      if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
        const log = shaders.map((s) => gl.getShaderInfoLog(s)).join(" ") + " " + gl.getProgramInfoLog(program);
        throw new Error("This browser does not make the program " + name + ": " + log.trim());
      }
      const places = new Map();
      this.linked.milliseconds += performance.now() - start;
      return {
        program,
        defines,
        place: (uniform) => {
          if (!places.has(uniform)) places.set(uniform, gl.getUniformLocation(program, uniform));
          return places.get(uniform);
        },
      };
    }

    defaultState() {
      const header = this.data.header,
        view = header.views[0];
      return {
        camera: JSON.parse(JSON.stringify(view.camera)),
        light: {
          environment: header.environments[0] || null,
          turn_deg: 0,
          illuminant: null,
          lamps: JSON.parse(JSON.stringify(header.lamps)),
        },
        objects: header.objects.map((o) => ({
          name: o.name,
          position_mm: o.position_mm.slice(),
          turn_deg: o.rotation_deg.slice(),
          visible: true,
        })),
        observer: header.observers[0].name,
        deficiency: null,
        display: { name: header.displays[0].name },
        exposure_ev: 0,
        overlay: null,
      };
    }

    power(illuminant) {
      return this.spectra.power(illuminant);
    }

    // Wavelengths, nm, at which an exchanged light has power that the room cannot give.
    missing(light) {
      return this.spectra.missing(light);
    }

    setTexture(program, name, own, unit) {
      const gl = this.gl;
      if (!own || program.place(name) === null) return;
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(own.target, own.texture);
      gl.uniform1i(program.place(name), unit);
    }

    // Rows of the scene's shapes where a state puts them.
    shapes(state, baked) {
      const header = this.data.header,
        surfaces = Irodori.surfaces(header),
        out = new Float32Array(4 * ROW * surfaces.length);
      let hidden = 0;
      surfaces.forEach((o, i) => {
        const at = state.objects[o.of ?? i] || {},
          put = (texel, values) => out.set(values, 4 * (ROW * i + texel));
        const turn = at.turn_deg ? turned(at.turn_deg) : o.world_from_object,
          size = o.size_mm.map((x) => x * o.scale);
        put(0, [...(at.position_mm || o.position_mm), o.reach_mm]);
        for (let c = 0; c < 3; c++)
          put(
            1 + c,
            turn.map((row) => row[c]),
          );
        put(4, [size[0], size[1], o.shape === "sphere" ? 2 / o.reach_mm : 0, KINDS[o.shape]]);
        const place = this.atlas.places[i];
        put(5, [place.x, place.y, o.texels[1], o.texels[0]]);
        put(6, [this.spectra.objects[i].index[0][0], this.spectra.objects[i].index[1][0], o.mirror, o.coat]);
        put(
          7,
          [0, 1, 2, 3].map((c) => (c < o.lobes.length ? o.lobes[c] : -1)),
        );
        const mesh = this.meshes[o.of ?? i];
        if (mesh) put(8, [mesh.first, mesh.last, mesh.triangles, o.scale]);
        if (baked && baked.places[i]) {
          put(9, baked.places[i]);
          put(10, o.map.grid);
        }
        put(11, [o.behind ?? -1, o.through ?? -1, (baked && baked.passed[i]) ?? 0, 0]);
        if (at.visible === false && i < header.objects.length) hidden |= 1 << i;
      });
      return { data: out, hidden };
    }

    // The light map of a state, null where none is known. A coarse one is made at once where that takes no time.
    bakedFor(state, isRGB) {
      if (!this.maps) return null;
      const kept = this.baked.get(this.lightKey(state, isRGB));
      if (kept) return kept;
      const isQuick = Object.keys(this.meshes).length === 0,
        transfer = this.maps.transfer(state, COARSE) || (isQuick && this.maps.trace(state, COARSE));
      return transfer ? this.bake(transfer, COARSE, state, isRGB) : null;
    }

    lightKey(state, isRGB) {
      const { environment, turn_deg, illuminant, lamps } = state.light;
      return JSON.stringify([
        Irodori.LightMaps.arrangement(state),
        [environment, turn_deg, illuminant, lamps, state.observer, isRGB],
      ]);
    }

    bake(transfer, fineness, state, isRGB) {
      const gl = this.gl,
        key = this.lightKey(state, isRGB),
        constants = this.spectra.constants(state.light, state.observer, isRGB),
        lanes = this.coloured && this.spectra.channels(constants).light,
        wide = this.coloured ? 4 : this.spectra.widest;
      // Numbers of a texel by the vectors of its light: in each channel of colours, or XYZ by the surface's vectors.
      const shown = (number, vectors) => {
        const columns = lanes
          ? vectors.map((v) => Array.from({ length: 16 }, (_, i) => lanes(v)[i] || 0))
          : vectors.map((v) =>
              this.spectra.objects[number].basis.flatMap((s) => [...this.spectra.pair(constants, v, s), 0]),
            );
        return columns[0].map((_, n) => columns.map((column) => column[n]));
      };
      const image = this.maps.texture(transfer, state, this.lamps(state.light.lamps || []), wide, shown),
        made = this.texture(image, gl.RGBA32F, gl.RGBA, gl.FLOAT, gl.NEAREST),
        old = this.baked.get(key);
      if (old) gl.deleteTexture(old.made.texture);
      this.baked.delete(key);
      this.baked.set(key, { made, fineness, places: image.places, passed: image.passed });
      for (const [other, { made: spare }] of this.baked) {
        if (this.baked.size <= KEPT) break;
        gl.deleteTexture(spare.texture);
        this.baked.delete(other);
      }
      return this.baked.get(key);
    }

    // The states whose light a picture shows, and whether as a plain renderer computes.
    static lit(state, compare) {
      if (!compare) return [[state, false]];
      if (compare.mode === "rgb")
        return [
          [state, false],
          [state, true],
        ];
      return [
        [state, false],
        [{ ...state, light: { ...state.light, ...compare.other } }, false],
      ];
    }

    // Whether the light on the objects is known as finely as it gets.
    knowsLight(state, compare) {
      return Irodori.Renderer.lit(state, compare).every(
        ([one, isRGB]) => !this.maps || this.baked.get(this.lightKey(one, isRGB))?.fineness === FINE,
      );
    }

    // Find the light on the objects, coarsely and then finely; `shown` is called after each. See light_maps.js.
    async findLight(state, compare, shown) {
      const asked = JSON.parse(JSON.stringify([state, compare ?? null]));
      for (const fineness of [COARSE, FINE]) {
        if (this.lost || this.knowsLight(...asked)) return;
        const maps = this.maps,
          transfer = maps.transfer(asked[0], fineness) || (await maps.traceSlowly(asked[0], fineness));
        if (!transfer || maps !== this.maps || this.lost) return; // something moved, or the context was lost meanwhile
        for (const [one, isRGB] of Irodori.Renderer.lit(...asked)) this.bake(transfer, fineness, one, isRGB);
        if (shown) shown();
      }
    }

    // What depends on spectra, made anew only where light, observer or lamps have other colours.
    colours(state, isRGB) {
      const part = state.light,
        lamps = (part.lamps || []).map((l) => [l.illuminant, l.on !== false, l.strength, l.position_mm, l.far]);
      const key = JSON.stringify([part.environment, part.illuminant, state.observer, isRGB, lamps]);
      if (this.lit && this.lit.key === key) return this.lit;
      const gl = this.gl,
        spectra = this.spectra,
        constants = spectra.constants(part, state.observer, isRGB);
      if (constants.lamps.length > MOST_LAMPS)
        throw new Error("Lamps: found " + constants.lamps.length + "; accepted: up to " + MOST_LAMPS + ".");
      const n = spectra.objects.length,
        KS = spectra.widest,
        found = { key, constants, whiteXYZ: constants.whiteXYZ };
      let width, rows, data;
      if (!this.coloured) {
        width = Math.max(constants.basis.length, 1) * KS;
        rows = n + Math.max(constants.spectra.length, 1) * n;
        data = spectra.forms(constants, width, rows);
        found.light = new Float32Array(constants.basis.flatMap((b) => constants.xyz(b)));
        found.lamps = new Float32Array(constants.spectra.flatMap((s) => constants.xyz(s).map((x) => x / Math.PI)));
      } else {
        const channels = spectra.channels(constants),
          padded = (values) => Array.from({ length: 16 }, (_, i) => values[i] || 0);
        width = 4 * KS + 8;
        rows = n;
        data = new Float32Array(4 * width * rows);
        spectra.objects.forEach((object, o) => {
          const put = (column, values) => data.set(padded(values), 4 * (o * width + column));
          object.basis.forEach((s, j) => put(4 * j, channels.surface(s)));
          const [index, absorption] = object.index.map((x) => channels.index(x));
          put(
            4 * KS,
            Array.from({ length: 16 }, (_, i) => index[i] || 1),
          );
          put(4 * KS + 4, absorption);
        });
        found.light = new Float32Array(constants.basis.flatMap((b) => padded(channels.light(b))));
        found.lamps = new Float32Array(
          constants.spectra.flatMap((s) => padded(channels.light(s)).map((x) => x / Math.PI)),
        );
        found.back = new Float32Array(channels.xyz.flatMap((row) => padded(row)));
      }
      if (this.textures.uForms) gl.deleteTexture(this.textures.uForms.texture);
      this.textures.uForms = this.texture({ data, width, height: rows }, gl.RGBA32F, gl.RGBA, gl.FLOAT, gl.NEAREST);
      this.lit = found;
      return found;
    }

    // The lamps that are on, as the shader reads them.
    lamps(all) {
      const lamps = all.filter((lamp) => lamp.on !== false),
        places = lamps.flatMap((lamp) => {
          const at = lamp.position_mm,
            length = Math.hypot(...at) || 1;
          return lamp.far ? [...at.map((x) => x / length), -1] : [...at, 0.5 * (lamp.size_mm || 0)];
        });
      const levels = lamps.map((lamp) => lamp.strength * (lamp.far ? 1 : 500 * 500));
      return { places: new Float32Array(places), levels: new Float32Array(levels) };
    }

    target(name, width, height, single) {
      const gl = this.gl,
        old = this.targets[name];
      if (old && old.width === width && old.height === height && old.single === single) return old;
      if (old) {
        old.textures.forEach((t) => gl.deleteTexture(t.texture));
        gl.deleteFramebuffer(old.frame);
      }
      const frame = gl.createFramebuffer(),
        internal = single ? gl.RGBA32F : gl.RGBA16F;
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      // Where a ray ends is asked for where numbers are read, and there alone.
      const textures = (single ? [0, 1, 2] : [0, 1]).map((i) => {
        const made = this.texture(
          { data: null, width, height },
          internal,
          gl.RGBA,
          single ? gl.FLOAT : gl.HALF_FLOAT,
          single || i ? gl.NEAREST : gl.LINEAR,
        );
        gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, made.texture, 0);
        return made;
      });
      gl.drawBuffers(textures.map((_, i) => gl.COLOR_ATTACHMENT0 + i));
      return (this.targets[name] = { frame, textures, width, height, single });
    }

    // Render a state into a target; `whole` is the picture's size and `first` the target's corner in it.
    render(state, target, whole, first, isRGB, part) {
      const gl = this.gl,
        light = this.lights[Math.max(this.data.header.environments.indexOf(state.light.environment), 0)];
      const program = light.program,
        colours = this.colours(state, isRGB),
        baked = this.bakedFor(state, isRGB),
        shapes = this.shapes(state, baked);
      const place = (name) => program.place(name);
      gl.useProgram(program.program);
      gl.bindVertexArray(this.vertices);
      gl.bindFramebuffer(gl.FRAMEBUFFER, target.frame);
      gl.viewport(0, 0, target.width, target.height);
      if (this.textures.uShapes) gl.deleteTexture(this.textures.uShapes.texture);
      this.textures.uShapes = this.texture(
        { data: shapes.data, width: ROW, height: shapes.data.length / (4 * ROW) },
        gl.RGBA32F,
        gl.RGBA,
        gl.FLOAT,
        gl.NEAREST,
      );
      const textures = { ...this.textures, ...light.textures, uLight: baked ? baked.made : this.textures.uShapes };
      for (const [unit, name] of TEXTURES.entries()) this.setTexture(program, name, textures[name], unit);
      const { eye, right, up, back } = Irodori.frame(state.camera),
        opposite = (v) => v.map((x) => -x);
      gl.uniform3fv(place("uEye"), eye);
      gl.uniformMatrix3fv(place("uWorldFromCamera"), false, [...right, ...opposite(up), ...opposite(back)]);
      gl.uniform3f(place("uFrame"), whole[0] / 2, whole[1] / 2, Irodori.pixel(state.camera, whole[1]));
      gl.uniform1i(place("uParallel"), Number(state.camera.height_mm > 0));
      gl.uniform2f(place("uFirstPixel"), first[0], first[1]);
      const turn = radians(state.light.turn_deg || 0),
        c = Math.cos(turn),
        s = Math.sin(turn);
      gl.uniformMatrix3fv(
        place("uLightFromWorld"),
        false,
        columns([
          [c, s, 0],
          [-s, c, 0],
          [0, 0, 1],
        ]),
      );
      gl.uniform1f(place("uLeast"), this.data.header.least_throughput);
      gl.uniform1i(place("uHidden"), shapes.hidden);
      gl.uniform1i(place("uBaked"), Number(baked !== null));
      gl.uniform1f(place("uPowerScale"), this.atlas.scale);
      const groups = Math.ceil(this.spectra.lights[light.number].basis.length / 4);
      const scale = Array.from({ length: 4 * groups }, (_, i) => light.scale[i] || 1);
      gl.uniform4fv(place("uLightScale"), scale);
      if (light.sky.length) {
        gl.uniform3fv(place("uSkyLevel"), light.sky.flat());
        gl.uniform3fv(place("uIrradianceLevel"), light.irradiance.flat());
        gl.uniform1f(place("uTexelsPerRad"), light.sky[0][2] * Math.sqrt(6 / (4 * Math.PI)));
      }
      if (this.data.header.coats.length) gl.uniform2fv(place("uCoat"), this.data.header.coats.flat());
      if (light.gloss.length) {
        gl.uniform3fv(place("uGlossLevel"), light.gloss.flat());
        gl.uniform1f(place("uGlossFirst"), light.first);
      }
      if (this.parts)
        gl.uniform2fv(
          place("uLadder"),
          this.data.header.lobes.flatMap((lobe) => lobe.ladder),
        );
      const lamps = this.lamps(state.light.lamps || []);
      gl.uniform1i(place("uLamps"), lamps.levels.length);
      if (lamps.levels.length) {
        gl.uniform4fv(place("uLamp"), lamps.places);
        gl.uniform1fv(place("uLampLevel"), lamps.levels);
      }
      if (this.coloured) {
        const all = new Float32Array(16 * 4 * groups);
        all.set(colours.light);
        gl.uniformMatrix4fv(place("uDecode"), false, all);
        if (colours.lamps.length) gl.uniformMatrix4fv(place("uLampColour"), false, colours.lamps);
        gl.uniform4fv(place("uXYZFromColour"), colours.back);
      } else {
        const all = new Float32Array(12 * groups);
        all.set(colours.light);
        gl.uniform3fv(place("uXYZFromLight"), all);
        if (colours.lamps.length) gl.uniform3fv(place("uLampColour"), colours.lamps);
      }
      if (part) {
        gl.enable(gl.SCISSOR_TEST);
        gl.scissor(part[0], 0, part[1] - part[0], target.height);
      }
      gl.drawArrays(gl.TRIANGLES, 0, 3);
      gl.disable(gl.SCISSOR_TEST);
      return colours;
    }

    shown(state, whiteXYZ) {
      const display = Irodori.screen(state.display || {}, this.data.header.displays);
      const factor = Math.pow(2, state.exposure_ev || 0) / whiteXYZ[1];
      const adapt = Irodori.adaptation(
        whiteXYZ.map((x) => x / whiteXYZ[1]),
        display.white_xyz,
      );
      return { display, matrix: Irodori.product(display.rgb_from_xyz, adapt).map((row) => row.map((x) => x * factor)) };
    }

    // One frame on the canvas.
    draw(state, options) {
      if (this.lost || !this.lights.length) return;
      const gl = this.gl,
        { compare = null, scale = 1 } = options || {},
        start = performance.now();
      const width = Math.max(Math.round(this.canvas.width * scale), 1),
        height = Math.max(Math.round(this.canvas.height * scale), 1);
      const whole = [width, height],
        one = this.target("one", width, height, false);
      const mode = compare ? (compare.mode === "rgb" ? 1 : Math.max(MODES.indexOf(compare.mode), 0)) : 0;
      const at = compare && compare.at !== undefined ? compare.at : 0.5,
        cut = Math.min(Math.max(Math.ceil(at * width) + 1, 1), width);
      const first = this.render(state, one, whole, [0, 0], false, mode === 1 ? [0, cut] : null);
      let second = first,
        two = one;
      if (compare) {
        const other = compare.mode === "rgb" ? state : { ...state, light: { ...state.light, ...compare.other } };
        two = this.target("two", width, height, false);
        second = this.render(
          other,
          two,
          whole,
          [0, 0],
          compare.mode === "rgb",
          mode === 1 ? [Math.max(cut - 3, 0), width] : null,
        );
      }
      this.show(state, [one, two], [first.whiteXYZ, second.whiteXYZ], mode, at);
      this.times.push(performance.now());
      if (this.times.length > 30) this.times.shift();
      this.scale = scale;
      this.drawn = performance.now() - start;
    }

    show(state, [one, two], whites, mode, at) {
      const gl = this.gl,
        program = this.programs.display,
        place = (name) => program.place(name);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
      gl.viewport(0, 0, this.canvas.width, this.canvas.height);
      gl.useProgram(program.program);
      [
        ["uOne", one.textures[0]],
        ["uTwo", two.textures[0]],
        ["uPlace", one.textures[1]],
      ].forEach(([name, texture], unit) => {
        gl.activeTexture(gl.TEXTURE0 + unit);
        gl.bindTexture(gl.TEXTURE_2D, texture.texture);
        gl.uniform1i(place(name), unit);
      });
      const key = JSON.stringify(state.display || {});
      if (this.screenKey !== key) {
        if (this.textures.uCodes) gl.deleteTexture(this.textures.uCodes.texture);
        this.textures.uCodes = this.texture(
          Irodori.codeTable(Irodori.screen(state.display || {}, this.data.header.displays)),
          gl.RGBA32F,
          gl.RGBA,
          gl.FLOAT,
          gl.NEAREST,
        );
        this.screenKey = key;
        // Where the browser can, codes of Display P3 are given to it as such; all others as those of the screen.
        if ("drawingBufferColorSpace" in gl)
          gl.drawingBufferColorSpace = (state.display || {}).name === "Display P3" ? "display-p3" : "srgb";
      }
      this.setTexture(program, "uCodes", this.textures.uCodes, 3);
      const shown = this.shown(state, whites[0]),
        sRGB = this.data.header.displays[0];
      gl.uniform2f(place("uCanvas"), this.canvas.width, this.canvas.height);
      gl.uniform1i(place("uMode"), mode);
      gl.uniform1i(place("uOverlay"), Math.max(OVERLAYS.indexOf(state.overlay), 0));
      gl.uniform1f(place("uAt"), at);
      gl.uniformMatrix3fv(place("uShown"), false, columns(shown.matrix));
      gl.uniformMatrix3fv(place("uShownTwo"), false, columns(this.shown(state, whites[1]).matrix));
      const between = Irodori.product(sRGB.rgb_from_xyz, Irodori.inverse(shown.display.rgb_from_xyz));
      gl.uniformMatrix3fv(place("uSRGBFromDisplay"), false, columns(between));
      gl.uniformMatrix3fv(place("uDisplayFromSRGB"), false, columns(Irodori.inverse(between)));
      const kind = this.data.header.deficiencies.find((d) => d.name === state.deficiency);
      gl.uniformMatrix3fv(
        place("uDeficiency"),
        false,
        columns(
          kind
            ? kind.rgb_from_rgb
            : [
                [1, 0, 0],
                [0, 1, 0],
                [0, 0, 1],
              ],
        ),
      );
      gl.uniform3fv(place("uWhite"), whites[0]);
      gl.uniform3fv(place("uWhiteTwo"), whites[1]);
      gl.uniform1f(place("uMostDifference"), 10);
      gl.uniform1f(place("uMostUncertainty"), this.data.header.most_uncertainty || 1);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }

    read(state, width, height, first, whole) {
      const gl = this.gl,
        target = this.target("read", width, height, true),
        out = [0, 1, 2].map(() => new Float32Array(4 * width * height));
      this.render(state, target, whole, first, false, null);
      out.forEach((values, i) => {
        gl.readBuffer(gl.COLOR_ATTACHMENT0 + i);
        gl.readPixels(0, 0, width, height, gl.RGBA, gl.FLOAT, values);
      });
      return out;
    }

    // X, Y, Z and the side seen (-1 for none) of every pixel of a picture, rows from the top; a white has Y = 100.
    readXYZ(state, width, height) {
      return this.read(state, width, height, [0, 0], [width, height])[0];
    }

    // What is known of the place under a pixel of the canvas, null where the room is seen; a place is {surface, texel,
    // position_mm}.
    probe(state, x, y) {
      const [[X, Y, Z, surface], [u, v], [px, py, pz]] = this.read(
        state,
        1,
        1,
        [Math.floor(x), Math.floor(y)],
        [this.canvas.width, this.canvas.height],
      );
      if (surface < 0) return null;
      const texel = Irodori.surfaces(this.data.header)[surface].texels.map((count, i) =>
        Math.min(Math.max(Math.floor([v, u][i] * count), 0), count - 1),
      );
      return { ...this.known({ surface, texel, position_mm: [px, py, pz] }), xyz: [X, Y, Z] };
    }

    // What is known of a place, wherever the eye is.
    known(place) {
      const { surface, texel } = place,
        o = Irodori.surfaces(this.data.header)[surface],
        [rows, columns_] = o.texels,
        plane = (name) => this.data.planes["object/" + surface + "/" + name];
      const at = texel[0] * columns_ + texel[1],
        basis = this.spectra.objects[surface].basis,
        texels = rows * columns_,
        coefficients = plane("reflectance");
      const reflectance = Array.from({ length: 61 }, (_, i) =>
        basis.reduce((sum, b, j) => sum + b[i] * coefficients[j * texels + at], 0),
      );
      const errors = this.data.header.error_nm.map((nm, i) => [nm, plane("spectral_error")[i * texels + at]]),
        found = { alpha: plane("alpha")[at], beta: null, mu_rad: null };
      if (o.lobes.length) {
        const [first, step] = this.data.header.lobes[o.lobes[0]].ladder,
          power = plane("power/0")[at];
        found.beta = 0;
        if (power > 0) {
          found.mu_rad = Math.exp(first + step * plane("place/0")[at]);
          found.beta = power / found.mu_rad ** 2;
        }
      }
      return {
        ...place,
        object: o.name,
        reflectance,
        // No error is 0: that stands where none is known.
        sigma: errors.every(([, error]) => error > 0)
          ? Array.from({ length: 61 }, (_, i) => Irodori.onLine(errors, 400 + 5 * i))
          : null,
        ...found,
        status: ["measured", "paint", "filled", "unknown"][plane("status")[at]],
      };
    }

    figures() {
      const n = this.times.length,
        span = n > 1 ? this.times[n - 1] - this.times[0] : 0;
      return {
        frames_per_s: span > 0 ? (1000 * (n - 1)) / span : 0,
        scale: this.scale || 1,
        programs_linked_ms: this.linked.milliseconds,
      };
    }
  };
})();
