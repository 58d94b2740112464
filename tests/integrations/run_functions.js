// Runs function nodes of a Node-RED flow as Node-RED does: one after the other, with one flow context.
// Standard input: [{"func": TEXT, "msg": {..}, "outputs": NUMBER, "later": true|absent}, ..]; a payload
// or correlationData as {"buffer": BASE64} becomes a Buffer. `later`: the timers run then.
// Standard output: for each what it returned and sent, as a list of messages for each output.
"use strict";
const vm = require("vm");
const steps = JSON.parse(require("fs").readFileSync(0));
const kept = {};
const timers = [];
let sent, statuses;

const flow = {get: key => kept[key], set: (key, value) => { kept[key] = value; }};
const env = {get: name => ({LINE: "hall-3"})[name]};
const RED = {util: {generateId: () => `id-${process.hrtime.bigint()}`}};
const node = {status: status => statuses.push(status), send};

function send(given) {
    const outputs = sent.length > 1 ? given || [] : [given];
    outputs.forEach((found, at) => sent[at].push(...[found].flat(2).filter(Boolean)));
}

function run(outputs, work) {
    sent = Array.from({length: outputs}, () => []);
    statuses = [];
    work();
    return {statuses, sent};
}

function call(step) {
    const setTimeout = work => timers.push({outputs: step.outputs, work});
    const msg = JSON.parse(JSON.stringify(step.msg || {}), revive);
    const context = {msg, node, flow, env, RED, Buffer, Date, setTimeout};
    return run(step.outputs, () => send(vm.runInNewContext(`(() => {${step.func}\n})()`, context)));
}

function runTimers() {
    const [{outputs, work}] = timers.splice(0);
    return run(outputs, work);
}

function plain(key, value) {
    return value && value.type === "Buffer" ? {buffer: Buffer.from(value.data).toString("base64")} : value;
}

function revive(key, value) {
    return value && value.buffer !== undefined ? Buffer.from(value.buffer, "base64") : value;
}

process.stdout.write(JSON.stringify(steps.map(step => step.later ? runTimers() : call(step)), plain));
