// The list of pixels on edges, which `edges.wgsl` writes and `trace.wgsl` reads: the workgroups of the refinement
// along each axis, then the number of pixels; and for each pixel the column, with the row from bit 15 on and
// bit 31 if its middle shows a surface, and the traced colour as four 16-bit floats.
#define_import_path bevy_vdb::trace::edge_list

// Where the number of pixels is.
const EDGE_COUNT: u32 = 3u;
const FIRST_EDGE: u32 = 4u;
const EDGE_WORDS: u32 = 3u;
// The most workgroups along an axis.
const MAX_GROUPS: u32 = 65535u;
// The workgroups along z when pixels on edges are refined. In the first trace of all pixels there is one.
const REFINEMENT_LAYERS: u32 = 2u;
