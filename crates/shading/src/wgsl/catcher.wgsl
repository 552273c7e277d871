// Twin of catcher.rs.

// Colour, multiplied by coverage, and coverage, that make `shaded` over `open`.
fn catcher_catch(shaded: vec3<f32>, open: vec3<f32>) -> vec4<f32> {
    let least = CATCHER_DARK * max(max(open.x, open.y), open.z);
    var kept = 1.0;
    for (var channel = 0; channel < 3; channel++) {
        if open[channel] > least {
            kept = min(kept, shaded[channel] / open[channel]);
        }
    }
    return vec4(max(shaded - kept * open, vec3(0.0)), 1.0 - kept);
}
