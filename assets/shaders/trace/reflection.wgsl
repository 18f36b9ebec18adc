// The part of a path that the denoising of reflections needs.
#define_import_path bevy_vdb::trace::reflection

#import bevy_pbr::lighting::perceptualRoughnessToRoughness
#import bevy_vdb::trace::segment::Segment
#import bevy_vdb::trace::shade::is_mirror
#import bevy_vdb::view::picture::luminance_of
#import bevy_vdb::view::reflection::Reflection
#import bevy_vdb::view::scene::view

// The reflection that is to be denoised, as far as the path has come: that in the first surface that blurs it.
struct PathReflection {
    own: Reflection,    // as far as it is known
    direct: vec3<f32>,  // luminance without it
    before: f32,        // length of the path between the first surface and this one
    first: f32,         // length of the segment behind it; negative if not known yet
    length: f32,        // length of the path behind it
    luminance: f32,     // of the light that it reflects
    closeness: f32,     // the same divided by how far the light has come
}

// Distances beyond this count as infinite.
const FARTHEST: f32 = 1e6;

// At a surface whose reflection is to be denoised. `direction` is the one in which a mirror would reflect. A mirror
// has no noise, so its reflectance is left at 0.
fn begin_reflection(
    path: ptr<function, PathReflection>,
    direct: vec3<f32>,
    roughness: f32,
    direction: vec3<f32>,
    reflectance: vec3<f32>,
) {
    let before = (*path).before + (*path).length;
    (*path) = PathReflection();
    (*path).own.direction = direction;
    if !is_mirror(roughness) {
        (*path).own.alpha = perceptualRoughnessToRoughness(roughness);
        (*path).own.reflectance = reflectance;
    }
    (*path).direct = direct;
    (*path).before = before;
    (*path).first = -1.0;
}

// At the end of the next segment.
fn continue_reflection(path: ptr<function, PathReflection>, distance: f32) {
    let far = min(distance, FARTHEST);
    (*path).length += far;
    (*path).first = select((*path).first, far, (*path).first < 0.0);
}

// Where light joins the path.
fn add_reflected(path: ptr<function, PathReflection>, color: vec3<f32>, distance: f32) {
    let luminance = luminance_of(color);
    (*path).luminance += luminance;
    (*path).closeness += luminance / max(distance, 1e-30);
}

// The standard deviation in pixels with which denoising may blur the reflection of something at a distance: about
// half that of the surface's own blur, so that the result is a tenth wider. A half vector that is turned by an angle
// turns the direction by twice as much. The reflected image appears as far behind the first surface, at `t`, as the
// path is long.
fn blur_at(path: PathReflection, distance: f32, primary: Segment, t: f32) -> f32 {
    let t_image = t + (path.before + distance) / max(length(primary.dir), 1e-30);
    let pixel = 2.0 * length(view.eye_x + t_image * view.dir_x) / f32(view.size.x);
    return path.own.alpha * distance / max(pixel, 1e-30);
}

// Whether the surface so far reflects the next one so sharply that its own reflection is what is to be denoised.
fn is_sharp(path: PathReflection, primary: Segment, t: f32) -> bool {
    return blur_at(path, path.first, primary, t) < 1.0;
}

// The blur for everything that a path has met. The first segment decides where edges are in the reflection, so light
// from beyond counts as at most three times as far.
fn final_blur(path: PathReflection, primary: Segment, t: f32) -> f32 {
    let met = path.luminance / max(path.closeness, 1e-30);
    let distance = select(path.first, clamp(met, path.first, 3.0 * path.first), path.luminance > 0.0);
    return blur_at(path, min(distance, FARTHEST), primary, t);
}
