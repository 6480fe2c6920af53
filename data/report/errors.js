// What goes wrong from here on is kept where a test or a curious reader finds it: <html data-errors="...">.
(() => {
  const note = (text) => {
    const page = document.documentElement.dataset;
    page.errors = (page.errors ? page.errors + "\n" : "") + text;
  };
  addEventListener("error", (event) => note(String(event.message)));
  addEventListener("unhandledrejection", (event) => note(String(event.reason)));
  addEventListener("securitypolicyviolation", (event) => note("refused by policy: " + event.blockedURI));
})();
