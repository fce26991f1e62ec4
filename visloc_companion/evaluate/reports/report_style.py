"""The style sheet of reports: no external fonts, light and dark, readable on paper, on a wide screen and on a phone."""

CSS = """
:root{color-scheme:light dark;--bg:#fff;--panel:#f6f7f9;--ink:#16191d;--soft:#59626e;--rule:#d5dae1;--grid:#e3e7ec;
--truth:#16191d;--estimate:#0068b4;--gnss:#d0470a;--fix:#b98500;--baseline:#8b3a9c;--sigma:#00805a;--level:#6b7480;--limit:#c01c28;
--good:#1a7f42;--bad:#c01c28;--warn:#a15c00;--halo:#fff;--ok-fill:#b9e2c6;--suspect-fill:#ffd58a;--denied-fill:#f5b0ab;
--waiting-fill:#d9dee5;--shadow-fill:#bcd7f2;--aiding-fill:#b9e2c6;--dead-fill:#ffd58a;--lost-fill:#f5b0ab;--on-fill:#16191d}
@media (prefers-color-scheme:dark){:root{--bg:#14171b;--panel:#1d2126;--ink:#eceff3;--soft:#a4aeba;--rule:#3a424c;--grid:#2b3138;
--truth:#f2f4f7;--estimate:#5cb8ff;--gnss:#ff9153;--fix:#e8c65a;--baseline:#d79be6;--sigma:#4fd1a0;--level:#98a2ae;--limit:#ff7b7b;
--good:#56c981;--bad:#ff7b7b;--warn:#f0b04c;--halo:#000;--ok-fill:#215c38;--suspect-fill:#74500f;--denied-fill:#7a2b29;
--waiting-fill:#3a424c;--shadow-fill:#1f4c78;--aiding-fill:#215c38;--dead-fill:#74500f;--lost-fill:#7a2b29;--on-fill:#eceff3}}
*{box-sizing:border-box}
body{margin:0;background:var(--bg);color:var(--ink);
font:16px/1.45 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif;overflow-wrap:anywhere}
main{max-width:1280px;margin:0 auto;padding:24px 20px 48px}
h1{font-size:26px;line-height:1.2;margin:0 0 4px}h2{font-size:20px;margin:36px 0 6px}h3{font-size:16px;margin:0 0 4px}
p{margin:4px 0 12px;max-width:78ch}.soft{color:var(--soft)}
.verdict{display:flex;flex-wrap:wrap;gap:16px;align-items:center;margin:16px 0;padding:14px 18px;border-radius:10px;
background:var(--panel);border-left:8px solid var(--good)}
.verdict.fail{border-color:var(--bad)}.verdict.open{border-color:var(--soft)}
.badge{font-size:30px;font-weight:750;letter-spacing:.03em;color:var(--good)}
.fail .badge{color:var(--bad)}.open .badge{color:var(--soft)}
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(210px,46%),1fr));gap:10px;margin:14px 0}
.tile{background:var(--panel);border-radius:8px;padding:10px 12px}.tile b{display:block;font-size:22px;line-height:1.25;
font-variant-numeric:tabular-nums}.tile span{color:var(--soft);font-size:14px}
table{overflow-wrap:normal;border-collapse:collapse;width:100%;font-size:15px;font-variant-numeric:tabular-nums}
th,td{text-align:left;padding:6px 10px;border-bottom:1px solid var(--rule);vertical-align:top}
th{color:var(--soft);font-weight:600}td.n,th.n{text-align:right}td.n{white-space:nowrap}td.name{overflow-wrap:anywhere;min-width:10ch}.yes{color:var(--good);font-weight:650}.no{color:var(--bad);font-weight:650}
.scroll{overflow-x:auto}.two{display:grid;grid-template-columns:repeat(2,minmax(0,1fr));gap:20px 28px}.two>*{min-width:0}
.pairs{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(480px,100%),1fr));gap:10px 14px}figure{margin:0}
.pair{display:grid;grid-template-columns:repeat(2,minmax(0,1fr));gap:14px}
img{display:block;width:100%;height:auto;border-radius:6px}figcaption{color:var(--soft);font-size:14px}
svg{display:block;width:100%;height:auto}.scroll>svg.wide{min-width:720px}
.legend{list-style:none;display:flex;flex-wrap:wrap;gap:4px 18px;margin:6px 0;padding:0;font-size:14px}
.legend li{display:flex;align-items:center;gap:7px}.key{width:28px;height:14px;flex:none}
dl{display:grid;grid-template-columns:max-content 1fr;gap:4px 16px;font-size:15px}dt{font-weight:650}dd{margin:0;max-width:78ch}
footer{margin-top:36px;padding-top:12px;border-top:1px solid var(--rule);color:var(--soft);font-size:14px}
text{fill:var(--ink);font-size:14px;font-family:inherit}.label{fill:var(--soft);font-variant-numeric:tabular-nums}.title{fill:var(--ink)}
.over{paint-order:stroke;stroke:var(--halo);stroke-width:4px;stroke-linejoin:round;font-weight:600}.strip{font-size:13px}
.grid{stroke:var(--grid)}.axis{stroke:var(--soft)}.frame{fill:none;stroke:var(--rule)}.photo{opacity:.78}
.truth,.estimate,.gnss,.baseline,.error,.sigma,.level,.limit,.halo,.cut{fill:none;stroke-linejoin:round;stroke-linecap:round}
.truth{stroke:var(--truth);stroke-width:2.6}.estimate{stroke:var(--estimate);stroke-width:2.4;stroke-dasharray:7 5}
.gnss{stroke:var(--gnss);stroke-width:2.4;stroke-dasharray:1.5 5}.baseline{stroke:var(--baseline);stroke-width:2.6}
.halo{stroke:var(--halo);stroke-width:6;opacity:.75}.error{stroke:var(--estimate);stroke-width:1.8}
.sigma{stroke:var(--sigma);stroke-width:1.8;stroke-dasharray:7 4}.level{stroke:var(--level);stroke-width:2}
.limit{stroke:var(--limit);stroke-width:1.6;stroke-dasharray:10 5}.cut{stroke:var(--ink);stroke-width:1.4;stroke-dasharray:4 4}
.dotfix{fill:var(--fix);fill-opacity:.6}.dotring{fill:none;stroke:var(--ink);stroke-width:1.5}.dotgnss{fill:var(--gnss);stroke:var(--halo);stroke-width:1.5}.dotstart{fill:var(--good);stroke:var(--halo);stroke-width:2}
.dotend{fill:var(--bad);stroke:var(--halo);stroke-width:2}.bar{fill:var(--estimate)}.mark{fill:var(--estimate)}.markno{fill:var(--bad)}
.band-suspect{fill:var(--suspect-fill);opacity:.45}.band-denied{fill:var(--denied-fill);opacity:.45}.plate{fill:var(--bg);opacity:.82}
.s-ok{fill:var(--ok-fill)}.s-suspect{fill:var(--suspect-fill)}.s-denied{fill:var(--denied-fill)}.s-waiting{fill:var(--waiting-fill)}
.s-shadow{fill:var(--shadow-fill)}.s-aiding{fill:var(--aiding-fill)}.s-dead_reckoning{fill:var(--dead-fill)}.s-lost{fill:var(--lost-fill)}
.r-available{fill:var(--ok-fill);opacity:.45}.r-unavailable{fill:var(--suspect-fill);opacity:.4}
.r-unavailable_misleading{fill:var(--suspect-fill);opacity:.7}.r-misleading{fill:var(--denied-fill);opacity:.45}
.r-hazardous{fill:var(--denied-fill);opacity:.95}
.dotr-available{fill:var(--good)}.dotr-unavailable,.dotr-unavailable_misleading{fill:var(--warn)}
.dotr-misleading,.dotr-hazardous{fill:var(--bad)}.d0{fill-opacity:.35}.d1{fill-opacity:.55}.d2{fill-opacity:.8}
.s-on{fill:var(--on-fill)}.s-off{fill:var(--waiting-fill)}
@media (max-width:760px){main{padding:14px 12px 36px}.two{grid-template-columns:minmax(0,1fr)}h1{font-size:22px}
.map text{font-size:21px}.half text{font-size:19px}td,th{padding:5px 6px;font-size:14px}td.wrap{white-space:normal}
.checks td,.checks th{padding:5px 3px}.checks td{overflow-wrap:anywhere}.checks td:nth-child(n+3){overflow-wrap:normal}
dl{grid-template-columns:1fr}dd{margin-bottom:6px}}
@media print{main{max-width:none}h2{break-after:avoid}svg,table{break-inside:avoid}}
"""
