// plots take the width of the page before it is printed, and that of the window again after
const fit=w=>document.querySelectorAll('.js-plotly-plot').forEach(p=>Plotly.relayout(p,w?{width:w}:{autosize:true}));
addEventListener('beforeprint',()=>fit(690));addEventListener('afterprint',()=>fit(0));
