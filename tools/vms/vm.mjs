// Runs a script on one of MicroPython's builds for WebAssembly:  node vm.mjs BUILD HEAP_KB FOLDERS SCRIPT ARGUMENT...
// BUILD is a version of the package (see package.json). The VM has a file system of its own, in memory: the FOLDERS of
// this computer, joined by ":", are copied there under the same names. The exit status is the script's.
import fs from 'node:fs';
import path from 'node:path';

const [build, heapKb, folders, script, ...args] = process.argv.slice(2);
const home = new URL(`./node_modules/micropython-${build}/`, import.meta.url);
const { loadMicroPython } = await import(new URL('micropython.mjs', home).href);
const vm = await loadMicroPython({
  heapsize: Number(heapKb) * 1024,
  url: new URL('micropython.wasm', home).pathname,
  linebuffer: true,
  stdout: line => console.log(line),
});

function copy(folder) {
  vm.FS.mkdirTree(folder);
  for (const entry of fs.readdirSync(folder, { withFileTypes: true })) {
    const name = path.join(folder, entry.name);
    if (entry.isDirectory()) { if (entry.name !== '__pycache__') copy(name); }
    else vm.FS.writeFile(name, fs.readFileSync(name));
  }
}
folders.split(':').forEach(copy);

const start = `
import sys
sys.argv[:] = ${JSON.stringify([script, ...args])}
__file__ = sys.argv[0]
with open(__file__) as f:
    source = f.read()
exec(compile(source, __file__, "exec"), globals())
`;
try {
  vm.runPython(start);
} catch (error) {
  const status = /SystemExit: (\d+)/.exec(error.message);
  if (!status) console.log(error.message);
  process.exitCode = status ? Number(status[1]) : 1;
}
