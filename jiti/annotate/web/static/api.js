// The server's JSON, and its errors as exceptions with what to do in them.

export class Refused extends Error {
  constructor(status, body) {
    super(body.error ?? `The server answered ${status}.`);
    this.status = status;
    this.body = body;
  }
}

export async function call(path, body, method = body === undefined ? "GET" : "POST") {
  let response;
  try {
    response = await fetch(path, {
      method,
      headers: body === undefined ? {} : { "Content-Type": "application/json" },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
  } catch {
    throw new Refused(0, { error: "The server does not answer. What was saved is safe; start jiti again and open the address that it prints." });
  }
  const text = await response.text();
  let answer;
  try {
    answer = JSON.parse(text);
  } catch {
    answer = { error: text };
  }
  if (!response.ok) throw new Refused(response.status, answer);
  return answer;
}

export const episodePath = (id, rest = "") => `/api/episodes/${encodeURIComponent(id)}${rest}`;

// Runs tasks one after another, so that each write is based on the version that the one before it made.
export class Line {
  #last = Promise.resolve();
  waiting = 0;

  drained() {
    return this.#last;
  }

  add(task) {
    this.waiting++;
    const run = this.#last.then(task).finally(() => this.waiting--);
    this.#last = run.catch(() => {});
    return run;
  }
}

export const count = (number, word) => `${number} ${word}${number === 1 ? "" : "s"}`;

export function text(id, value) {
  const element = document.getElementById(id);
  if (element.textContent !== value) element.textContent = value;
}

export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === "data") Object.assign(element.dataset, value);
    else if (name.startsWith("aria-")) element.setAttribute(name, value);
    else element[name] = value;
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

export function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  localStorage.setItem("jiti-theme", theme);
}

export function theme() {
  return localStorage.getItem("jiti-theme") ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
}
