// MathML of every formula of the documentation, so that pages need no script to show them.
//   npx --yes --package katex@0.19.1 -- node docs/hooks/write_formulas.mjs
// reads the blocks ```math of docs/**/*.md and writes docs/hooks/formulas.json: TeX -> MathML.
import { readdirSync, readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

const hooks = dirname(fileURLToPath(import.meta.url)), docs = dirname(hooks);
const folders = (process.env.PATH ?? "").split(":").filter((one) => one.endsWith("node_modules/.bin"));
const where = [...folders.map((one) => join(dirname(one), "katex")), process.env.KATEX ?? ""];
const found = where.find((one) => { try { return readFileSync(join(one, "package.json")); } catch { return false; } });
const katex = createRequire(pathToFileURL(join(found ?? docs, "package.json")))(found ?? "katex");

const formulas = {};
for (const name of readdirSync(docs, { recursive: true }).sort()) {
  if (!name.endsWith(".md")) continue;
  for (const [, text] of readFileSync(join(docs, name), "utf-8").matchAll(/^```math\n([^]*?)^```/gm)) {
    const tex = text.trim();
    formulas[tex] = katex.renderToString(tex, { output: "mathml", displayMode: true, strict: "error" });
  }
}
writeFileSync(join(hooks, "formulas.json"), JSON.stringify(formulas, null, 1) + "\n");
