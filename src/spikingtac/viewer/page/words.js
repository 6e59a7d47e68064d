// Plain names of the tracker's settings, and what each of them does.
export const WORDS = {
  "hysteresis": ["output", "What is done to the position before it is given out. none: nothing. paper, anchored: small displacements are drawn towards the rest, against the skin's creep."],
  "denoiser": ["noise filter", "Cleans the map of brightness before markers are looked for."],
  "disc.leak_per_s": ["forgetting of errors", "How fast the map gives up what noise and lost events left in it."],
  "disc.backlash": ["play", "A found disc stays behind its marker, most after it turned round. Here is how much of that is made good."],
  "disc.shrink": ["smoothing", "A marker that differs a little from what its neighbours expect is drawn towards it: so small a difference is more likely an error than deformation."],
  "disc.adapt_to_loss": ["make up for lost events", "Each event counts for more when fewer arrive than the motion asks for."],
  "blobs.threshold": ["brightness of a marker", "Pixels at or above this level belong to a marker."],
  "blobs.support_us": ["filter of lone events", "An event counts only if a neighbour had one within this time; 0 is no filter."],
  "blobs.refresh_us": ["renewal of the map", "How often the cleaned map replaces the map; 0 is never."],
  "paper_law.delta_px": ["window around the rest", "Displacements up to this are damped."],
  "paper_law.gamma": ["gain in the window", "1 does not damp, 0 holds the marker at its rest."],
};
