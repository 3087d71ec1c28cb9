// all is unfolded and plots take the width of the page before it is printed; after, it is as it was
const fit=w=>document.querySelectorAll('.js-plotly-plot').forEach(p=>Plotly.relayout(p,w?{width:w}:{autosize:true}));
let folded=[];
addEventListener('beforeprint',()=>{folded=unfold();fit(690)});
addEventListener('afterprint',()=>{folded.forEach(fold=>{fold.open=false});fit(0)});
