// Two ordinary pages side by side; each names its finger, and passes on the token of this one.
for (const [number, id] of ["first", "second"].entries()) {
  const query = new URLSearchParams(location.search);
  query.set("finger", number);
  document.getElementById(id).src = `index.html?${query}`;
}
