// Prints what the search of a built guide finds: node guide_search.js SITE QUERY...
// Runs the worker of mkdocs-material without a browser; one line [query, [address, ...]] per query.
const fs = require("fs"), vm = require("vm");

const [site, ...queries] = process.argv.slice(2);
const folder = `${site}/assets/javascripts/workers/`;
const script = fs.readFileSync(folder + fs.readdirSync(folder).find((name) => name.endsWith(".js")), "utf8");
const index = JSON.parse(fs.readFileSync(`${site}/search/search_index.json`));
const SETUP = 0, READY = 1, QUERY = 2, RESULT = 3;

let receive;
const waiting = {};
const scope = {
  location: { href: "http://127.0.0.1/" },
  addEventListener: (_, handler) => { receive = handler; },
  postMessage: (message) => waiting[message.type]?.(message.data),
  importScripts: () => {},
  console, setTimeout, URL,
};
scope.self = scope;
vm.runInNewContext(script, scope);

async function asked(type, data, answer) {
  const got = new Promise((done) => { waiting[answer] = done; });
  await receive({ data: { type, data } });
  return got;
}

(async () => {
  await asked(SETUP, { config: index.config, docs: index.docs, options: { suggest: false } }, READY);
  for (const query of queries) {
    const { items } = await asked(QUERY, query, RESULT);
    console.log(JSON.stringify([query, items.slice(0, 4).map(([first]) => first.location)]));
  }
})();
