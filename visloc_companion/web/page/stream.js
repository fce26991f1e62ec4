// The stream of views, opened anew where it has ended, and where nothing has come for long: a connection that broke without a
// word (the radio lost it) stays open in a browser that sends nothing, and the page would never hear of the server again.
const AGAIN_MS = 2000, SILENT_MS = 10000;

export class Stream {
  constructor(onHistory, onView) {
    Object.assign(this, { onHistory, onView });
    this.open();
  }

  open() {
    this.source?.close();
    this.heard = performance.now();
    const source = this.source = new EventSource("/api/stream");
    const said = (name, take) => source.addEventListener(name, (event) => {
      this.heard = performance.now();
      take(JSON.parse(event.data));
    });
    said("history", this.onHistory);
    said("view", this.onView);
    source.onerror = () => {
      if (source.readyState === EventSource.CLOSED && source === this.source) setTimeout(() => this.again(source), AGAIN_MS);
    };
  }

  again(ended) {
    if (ended === this.source) this.open();
  }

  // To be called now and then
  look() {
    if (performance.now() - this.heard > SILENT_MS) this.open();
  }
}
