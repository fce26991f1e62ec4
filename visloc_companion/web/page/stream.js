// The stream of views, opened anew where it has ended, and where nothing has come for long: a connection that broke without a
// word (the radio lost it) stays open in a browser that sends nothing, and the page would never hear of the server again.
// The history is long: a slow line may take a minute for it. What such a line still holds is late, which the server's clock tells.
const AGAIN_MS = 2000, SILENT_MS = 10000, HISTORY_MS = 60000;

export class Stream {
  constructor(onHistory, onView) {
    Object.assign(this, { onHistory, onView });
    this.open();
  }

  open() {
    this.source?.close();
    this.heard = performance.now();
    const source = this.source = new EventSource("api/stream");
    this.patience = SILENT_MS;
    const said = (name, take) => source.addEventListener(name, (event) => {
      this.heard = performance.now();
      this.patience = SILENT_MS;
      const data = JSON.parse(event.data);
      take(data, this.late(data.at_s, name === "history"));
    });
    said("history", this.onHistory);
    said("view", this.onView);
    source.onopen = () => {
      this.opened = this.heard = performance.now();
      this.patience = HISTORY_MS;
    };
    source.onerror = () => {
      if (source.readyState === EventSource.CLOSED && source === this.source) setTimeout(() => this.again(source), AGAIN_MS);
    };
  }

  // Seconds since the server said something, beyond what its first answer on this connection took
  late(at_s, first) {
    if (!Number.isFinite(at_s)) return 0;
    const ahead = performance.now() / 1000 - at_s;
    if (first) this.ahead = this.opened / 1000 - at_s;
    this.ahead = Math.min(this.ahead ?? ahead, ahead);
    return ahead - this.ahead;
  }

  again(ended) {
    if (ended === this.source) this.open();
  }

  // To be called now and then
  look() {
    if (performance.now() - this.heard > this.patience) this.open();
  }
}
