"""Photos made to look like splat renders: stage 1, one pure function an artefact behind a gate; stage 2, learnt."""
