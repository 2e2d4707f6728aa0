// The default of a material's own shader: nothing is changed.
fn surface(s: Surface, at: At) -> Surface {
    return s;
}
