/*
 * The ground as a camera sees it, road slope, and the fusion of both with a network's heads: GEDepth (ICCV 2023) for
 * firmware. Made by cbindgen from core/ffi/src; do not edit. How to link it and what to expect of it: core/ffi/README.md.
 *
 * - Lengths are numbers of ELEMENTS, never bytes. Maps and tables are row-major, index = v * width + u.
 * - Every function that returns int32_t checks pointers (null, alignment), lengths, overlap of what it writes with all
 *   else, and every number, and returns one of the numbered results. After any result but GEDEPTH_CORE_OK no output has
 *   been touched, scratch memory aside.
 * - Nothing is kept between calls and nothing is allocated. Any function may run on any thread or in any interrupt; memory
 *   that one call writes must not be used by another at the same time. Memory that is only read may be shared.
 * - The caller's part: pointers that are not null lead to that many elements, and a gedepth_core_camera was zeroed
 *   or set by this library.
 */

#ifndef GEDEPTH_CORE_H
#define GEDEPTH_CORE_H

#include <stddef.h>
#include <stdint.h>

// The version of the binary interface: changes when something that was is no more, or means something else.
// Additions do not change it.
#define GEDEPTH_CORE_ABI_VERSION 2

// No distortion.
#define GEDEPTH_CORE_PINHOLE 1

// Brown-Conrady: k1, k2, p1, p2, k3, and k4, k5, k6 of the rational form or 0; OpenCV's order, ROS `plumb_bob` and
// `rational_polynomial`.
#define GEDEPTH_CORE_BROWN_CONRADY 2

// Kannala-Brandt fisheye: k1, k2, k3, k4; OpenCV `fisheye`, ROS `equidistant`.
#define GEDEPTH_CORE_KANNALA_BRANDT 3

// Heads are upsampled with half-pixel centres: PyTorch's and ONNX's align_corners off.
#define GEDEPTH_CORE_HALF_PIXEL 1

// Heads are upsampled from corner centre to corner centre: align_corners on.
#define GEDEPTH_CORE_ALIGN_CORNERS 2

// float.
#define GEDEPTH_CORE_F32 1

// uint8_t, (value - zero_point) * scale.
#define GEDEPTH_CORE_U8 2

// int8_t, (value - zero_point) * scale.
#define GEDEPTH_CORE_I8 3

// Residual depth in metres.
#define GEDEPTH_CORE_METRES 1

// Residual depth as natural logarithm of metres.
#define GEDEPTH_CORE_LOG_METRES 2

// Attention or slope as logits.
#define GEDEPTH_CORE_LOGIT 3

// Attention as M itself, 0 to 1.
#define GEDEPTH_CORE_PROBABILITY 4

// Residual depth as natural logarithm of depth over focal length, the metres that a pixel of the network's input spans there.
#define GEDEPTH_CORE_LOG_METRES_PER_PIXEL 5

// Exponentials and softmax before upsampling: 4 to 16 times cheaper.
#define GEDEPTH_CORE_DECODE_AT_HEAD 1

// Exponentials and softmax after upsampling.
#define GEDEPTH_CORE_DECODE_AT_OUTPUT 2

// Done.
#define GEDEPTH_CORE_OK 0

// A pointer that must not be null is.
#define GEDEPTH_CORE_NULL_POINTER 1

// A pointer is not aligned for its type.
#define GEDEPTH_CORE_MISALIGNED 2

// Memory that is written overlaps other memory of the same call.
#define GEDEPTH_CORE_OVERLAP 3

// An array is longer than memory.
#define GEDEPTH_CORE_TOO_LONG 4

// The camera has no lens yet.
#define GEDEPTH_CORE_CAMERA_NOT_SET 5

// The camera has no ground yet.
#define GEDEPTH_CORE_POSE_NOT_SET 6

// A number that chooses among named values is none of them.
#define GEDEPTH_CORE_UNKNOWN_CHOICE 7

// Something that is not used must be 0 and is not.
#define GEDEPTH_CORE_UNUSED_NOT_ZERO 8

// Only a camera without distortion can do this.
#define GEDEPTH_CORE_NOT_A_PINHOLE 9

// The picture does not show the vanishing line: all ground or all sky. Not a fault.
#define GEDEPTH_CORE_NO_VANISHING_LINE 10

// The camera has no ray with a depth there. Not a fault.
#define GEDEPTH_CORE_NO_RAY 11

// An argument is not finite, or a depth not positive.
#define GEDEPTH_CORE_NOT_FINITE 12

// A zero point is outside its 8-bit type.
#define GEDEPTH_CORE_ZERO_POINT 13

// A picture has no pixel, or a side longer than 65535.
#define GEDEPTH_CORE_IMAGE_SIZE 101

// Focal length.
#define GEDEPTH_CORE_FOCAL_LENGTH 102

// Principal point.
#define GEDEPTH_CORE_PRINCIPAL_POINT 103

// Skew.
#define GEDEPTH_CORE_SKEW 104

// Not used by the C interface.
#define GEDEPTH_CORE_INTRINSIC_MATRIX 105

// Distortion coefficient.
#define GEDEPTH_CORE_DISTORTION_COEFFICIENT 106

// Not used by the C interface.
#define GEDEPTH_CORE_CROP_OUTSIDE_PICTURE 107

// Not used by the C interface.
#define GEDEPTH_CORE_BINNING 108

// The plane's normal has no direction.
#define GEDEPTH_CORE_DIRECTION_WITHOUT_LENGTH 201

// R is no rotation.
#define GEDEPTH_CORE_NOT_A_ROTATION 202

// R mirrors.
#define GEDEPTH_CORE_REFLECTION 203

// Translation.
#define GEDEPTH_CORE_TRANSLATION 204

// Angle.
#define GEDEPTH_CORE_ANGLE_NOT_FINITE 205

// Offset of the ground plane.
#define GEDEPTH_CORE_PLANE_OFFSET 301

// Height over the ground.
#define GEDEPTH_CORE_CAMERA_NOT_ABOVE_GROUND 302

// Length of a table.
#define GEDEPTH_CORE_TABLE_LENGTH 401

// Not used by the C interface.
#define GEDEPTH_CORE_TABLE_NOT_BUILT 402

// One value a row would be wrong by more than the tolerance.
#define GEDEPTH_CORE_ROLL_TOO_LARGE 403

// Not reached through the C interface.
#define GEDEPTH_CORE_GROUND_ROW 404

// Number of slope classes.
#define GEDEPTH_CORE_SLOPE_CLASS_COUNT 501

// Angle of a slope class.
#define GEDEPTH_CORE_SLOPE_ANGLE 502

// Number of slope logits.
#define GEDEPTH_CORE_SLOPE_LOGIT_COUNT 503

// A slope logit is NaN or infinite.
#define GEDEPTH_CORE_SLOPE_LOGIT_NOT_FINITE 504

// Length of a head.
#define GEDEPTH_CORE_HEAD_LENGTH 601

// Channels of a head.
#define GEDEPTH_CORE_HEAD_CHANNELS 602

// A value of a head is NaN or beyond +-1e37.
#define GEDEPTH_CORE_HEAD_NOT_FINITE 603

// Scale of an 8-bit head.
#define GEDEPTH_CORE_QUANTIZATION_SCALE 604

// Depth range.
#define GEDEPTH_CORE_DEPTH_RANGE 605

// Ground limit.
#define GEDEPTH_CORE_GROUND_LIMIT 606

// Length of an output.
#define GEDEPTH_CORE_OUTPUT_LENGTH 607

// Length of the scratch memory.
#define GEDEPTH_CORE_SCRATCH_LENGTH 608

// Not used by the C interface.
#define GEDEPTH_CORE_HEAD_SIZE 609

// Not used by the C interface.
#define GEDEPTH_CORE_DISTANCE_INTERVALS 701

// Not used by the C interface.
#define GEDEPTH_CORE_CLOUD_THRESHOLD 702

// Classes are positive where the road falls away, the paper's Eq. 6.
#define GEDEPTH_CORE_DOWNHILL_POSITIVE 1

// Classes are positive where the road rises.
#define GEDEPTH_CORE_UPHILL_POSITIVE 2

// Most slope classes.
#define GEDEPTH_CORE_MAX_SLOPE_CLASSES 64

// float, inverse depth in 1/m with its sign, one a pixel.
#define GEDEPTH_CORE_INVERSE_DEPTH 1

// uint16_t, depth in 1/256 m up to 255 m, 0 for none, one a pixel.
#define GEDEPTH_CORE_METRES_256 2

// float, inverse depth in 1/m with its sign, one a row.
#define GEDEPTH_CORE_ROWS 3

// No table: three coefficients of a camera without distortion.
#define GEDEPTH_CORE_COEFFICIENTS 4

// A camera, in memory that the caller owns: 512 bytes, aligned as uint64_t, the same for every version with this
// GEDEPTH_CORE_ABI_VERSION. Zero it before the first use. What is inside belongs to the library, holds no pointer and may
// be copied, but only between programs with the very same library.
typedef struct gedepth_core_camera {
  // The library's.
  uint64_t opaque[64];
} gedepth_core_camera;

// Picture size, K and distortion. Pixels have integer coordinates at their centres; u to the right, v down:
// u = fx x + skew y + cx, v = fy y + cy.
typedef struct gedepth_core_lens {
  // Columns, 1 to 65535.
  uint32_t width;
  // Rows, 1 to 65535.
  uint32_t height;
  // GEDEPTH_CORE_PINHOLE, GEDEPTH_CORE_BROWN_CONRADY or GEDEPTH_CORE_KANNALA_BRANDT.
  uint32_t distortion;
  // 0.
  uint32_t reserved;
  // Focal length in columns, 0.01 to 1e7.
  double fx;
  // Focal length in rows, 0.01 to 1e7.
  double fy;
  // Principal point, column, within +-1e6.
  double cx;
  // Principal point, row, within +-1e6.
  double cy;
  // Skew, pixels, within +-1e6.
  double skew;
  // Of the distortion, each within +-1e6; those that it has not are 0.
  double coefficients[8];
} gedepth_core_lens;

// World to camera, p_camera = R p_world + T, and the ground plane up . p_world = offset. Metres. The camera's frame is
// x right, y down, z forward; the world's is any.
typedef struct gedepth_core_extrinsics {
  // R, rows; orthonormal to 1e-3.
  double r[9];
  // T, metres, each within +-1e9.
  double t[3];
  // A normal of the plane, pointing out of the ground; its length does not matter.
  double plane_up[3];
  // Where the plane lies along the normal of length 1, metres, within +-1e9.
  double plane_offset;
} gedepth_core_extrinsics;

// The short way, without a calibration file: how the camera is mounted over the road.
typedef struct gedepth_core_mounting {
  // Of the centre of projection over the ground, metres, 0.001 to 1e5.
  double height;
  // Radians, positive looks down.
  double pitch;
  // Radians, positive lowers the right side.
  double roll;
  // Radians; does not change what is seen of a plane, but must be finite.
  double yaw;
} gedepth_core_mounting;

// The two ends of the vanishing line in the picture, left one first, pixels.
typedef struct gedepth_core_line {
  // Left end, column.
  double u0;
  // Left end, row.
  double v0;
  // Right end, column.
  double u1;
  // Right end, row.
  double v1;
} gedepth_core_line;

// What all modes have in common.
typedef struct gedepth_core_fusion {
  // GEDEPTH_CORE_HALF_PIXEL or GEDEPTH_CORE_ALIGN_CORNERS.
  uint32_t upsampling;
  // Depth is clamped to at least this, metres, above 0.
  float depth_min;
  // Depth is clamped to at most this, metres, finite and above depth_min.
  float depth_max;
  // Ground farther than this counts as none, metres, positive and finite; not read by the baseline.
  float ground_limit;
} gedepth_core_fusion;

// One output of a network: planes of width x height, row-major, one after the other (NCHW with N = 1).
typedef struct gedepth_core_head {
  // The values, of the format's type; f32 ones within +-1e37.
  const void *values;
  // Their number, exactly channels * width * height.
  size_t values_len;
  // GEDEPTH_CORE_F32, GEDEPTH_CORE_U8 or GEDEPTH_CORE_I8.
  uint32_t format;
  // 1 for the residual and the attention, the number of classes for the slope.
  uint32_t channels;
  // Columns.
  uint32_t width;
  // Rows.
  uint32_t height;
  // Residual: GEDEPTH_CORE_METRES, GEDEPTH_CORE_LOG_METRES or GEDEPTH_CORE_LOG_METRES_PER_PIXEL; attention:
  // GEDEPTH_CORE_LOGIT or GEDEPTH_CORE_PROBABILITY; slope: GEDEPTH_CORE_LOGIT.
  uint32_t unit;
  // GEDEPTH_CORE_DECODE_AT_HEAD or GEDEPTH_CORE_DECODE_AT_OUTPUT.
  uint32_t decode_at;
  // Of 8-bit formats, positive, 255 times it at most 1e37; not read for GEDEPTH_CORE_F32.
  float scale;
  // Of 8-bit formats; not read for GEDEPTH_CORE_F32.
  int32_t zero_point;
  // Of GEDEPTH_CORE_LOG_METRES_PER_PIXEL, sqrt(fx fy) of the network's input, pixels, 0.01 to 1e7; not read for others.
  float focal_length;
} gedepth_core_head;

// A ground table: what the functions that make one fill in, and what fusion reads. Plain data; may be filled in by hand
// for a table kept in flash. Row-major, index = v * width + u.
typedef struct gedepth_core_ground {
  // GEDEPTH_CORE_INVERSE_DEPTH, GEDEPTH_CORE_METRES_256, GEDEPTH_CORE_ROWS or GEDEPTH_CORE_COEFFICIENTS.
  uint32_t form;
  // Columns.
  uint32_t width;
  // Rows.
  uint32_t height;
  // Of the camera over the ground, metres.
  float camera_height;
  // The table, of the form's type; not read for GEDEPTH_CORE_COEFFICIENTS.
  const void *values;
  // Its elements, exactly what the form takes.
  size_t values_len;
  // a, b, c of 1/z = a + b u + c v in 1/m; read for GEDEPTH_CORE_COEFFICIENTS only.
  double coefficients[3];
} gedepth_core_ground;

// Where results go. Each length is exactly the picture's pixels, or 0 with a null pointer where a map is not wanted.
typedef struct gedepth_core_maps {
  // Depth, metres; wanted always.
  float *depth;
  // Elements of depth.
  size_t depth_len;
  // M, the attention at the picture's size, 0 to 1, or null.
  float *attention;
  // Elements of attention.
  size_t attention_len;
  // The ground depth that went into the fusion, metres, 0 for none, or null.
  float *ground;
  // Elements of ground.
  size_t ground_len;
} gedepth_core_maps;

// The angles of a network's slope classes, in the order of its channels.
typedef struct gedepth_core_slope_classes {
  // Radians, ascending, within +-30 degrees.
  const double *radians;
  // Angles, 1 to GEDEPTH_CORE_MAX_SLOPE_CLASSES.
  size_t radians_len;
  // GEDEPTH_CORE_DOWNHILL_POSITIVE or GEDEPTH_CORE_UPHILL_POSITIVE.
  uint32_t sign;
  // 0.
  uint32_t reserved;
} gedepth_core_slope_classes;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// The library's GEDEPTH_CORE_ABI_VERSION; compare it with the header's before the first call.
uint32_t gedepth_core_abi_version(void);

// The library's version, "major.minor.patch", in static memory.
const char *gedepth_core_version(void);

// Sets the lens and forgets the ground. Costly for distortions (they are checked for folds): once per calibration.
int32_t gedepth_core_camera_set_lens(struct gedepth_core_camera *camera, const struct gedepth_core_lens *lens);

// Sets the ground from extrinsics and a plane. The lens must have been set.
int32_t gedepth_core_camera_set_extrinsics(struct gedepth_core_camera *camera,
                                           const struct gedepth_core_extrinsics *extrinsics);

// Sets the ground from how the camera is mounted. The lens must have been set.
int32_t gedepth_core_camera_set_mounting(struct gedepth_core_camera *camera,
                                         const struct gedepth_core_mounting *mounting);

// The ground as the camera sees it: the direction straight down (x, y, z in the camera's frame, unit length; may be
// null) and the camera's height over the ground in metres (may be null).
int32_t gedepth_core_camera_ground(const struct gedepth_core_camera *camera, double (*down)[3], double *height);

// The vanishing line's ends. GEDEPTH_CORE_NO_VANISHING_LINE if the picture does not show it, which is no fault. Costs one
// unprojection for every pixel of the picture's frame.
int32_t gedepth_core_vanishing_line(const struct gedepth_core_camera *camera,
                                    struct gedepth_core_line *line);

// The inverse ground depth 1/z at pixel (u, v), anywhere, 1/m: positive below the vanishing line, negative above.
// GEDEPTH_CORE_NO_RAY where the camera sees nothing that has a depth.
int32_t gedepth_core_inverse_depth_at(const struct gedepth_core_camera *camera,
                                      double u,
                                      double v,
                                      double *inverse_depth);

// Baseline: the residual is the depth. scratch_len at least gedepth_core_scratch_len(width, height, head width, 0),
// depth_len exactly width * height.
int32_t gedepth_core_fuse_baseline(const struct gedepth_core_fusion *settings,
                                   uint32_t width,
                                   uint32_t height,
                                   const struct gedepth_core_head *residual_head,
                                   float *scratch,
                                   size_t scratch_len,
                                   float *depth,
                                   size_t depth_len);

// Vanilla: ground depth from the plane. scratch_len at least gedepth_core_scratch_len(width, height, widest head, 0).
int32_t gedepth_core_fuse_vanilla(const struct gedepth_core_fusion *settings,
                                  const struct gedepth_core_ground *ground,
                                  const struct gedepth_core_head *residual_head,
                                  const struct gedepth_core_head *attention_head,
                                  float *scratch,
                                  size_t scratch_len,
                                  const struct gedepth_core_maps *maps);

// Adaptive: ground depth from the plane and the expected slope (Eq. 7 and 8). scratch_len at least
// gedepth_core_scratch_len(width, height, widest head, classes).
int32_t gedepth_core_fuse_adaptive(const struct gedepth_core_fusion *settings,
                                   const struct gedepth_core_ground *ground,
                                   const struct gedepth_core_head *residual_head,
                                   const struct gedepth_core_head *attention_head,
                                   const struct gedepth_core_head *slope_head,
                                   const struct gedepth_core_slope_classes *slope_classes,
                                   float *scratch,
                                   size_t scratch_len,
                                   const struct gedepth_core_maps *maps);

// Elements of scratch memory that fusion takes at most, for a picture of this size, heads of at most head_width columns and
// this many slope classes (0 for the baseline and vanilla; 1 is enough for any number decoded at the head's size); 0 for a
// picture size that is refused. Also GEDEPTH_CORE_SCRATCH_LEN.
size_t gedepth_core_scratch_len(uint32_t width,
                                uint32_t height,
                                uint32_t head_width,
                                size_t slope_classes);

// What a result means, in English, in static memory; never null.
const char *gedepth_core_result_text(int32_t result);

// The expected slope of one pixel (Eq. 8), radians, positive downhill: softmax of logits_len logits, one a class, times the
// angles.
int32_t gedepth_core_expected_slope(const struct gedepth_core_slope_classes *slope_classes,
                                    const float *logits,
                                    size_t logits_len,
                                    float *radians);

// The slope at a measured planar depth (Eq. 9), radians, positive downhill; inverse_plane is the plane's inverse depth
// there (gedepth_core_inverse_depth_at or a table's value), measured is in metres.
int32_t gedepth_core_slope_from_depth(const struct gedepth_core_camera *camera,
                                      double inverse_plane,
                                      double measured,
                                      double *radians);

// The class nearest to a slope (radians, positive downhill), from 0.
int32_t gedepth_core_nearest_slope_class(const struct gedepth_core_slope_classes *slope_classes,
                                         float radians,
                                         uint32_t *class_index);

// The inverse depth of sloped ground (Eq. 7), 1/m: that of the plane less tan(slope) / height; slope in radians, positive
// downhill.
int32_t gedepth_core_sloped_inverse_depth(const struct gedepth_core_camera *camera,
                                          double inverse_plane,
                                          double slope,
                                          double *inverse_depth);

// Makes the table of inverse depths: values_len floats, at least gedepth_core_table_len.
int32_t gedepth_core_table_build(const struct gedepth_core_camera *camera,
                                 float *values,
                                 size_t values_len,
                                 struct gedepth_core_ground *ground);

// Makes the table of depths in 1/256 m: values_len uint16_t, at least gedepth_core_table_len. Keeps nothing above the
// vanishing line: not for the adaptive mode where roads rise.
int32_t gedepth_core_table_build_metres(const struct gedepth_core_camera *camera,
                                        uint16_t *values,
                                        size_t values_len,
                                        struct gedepth_core_ground *ground);

// Makes the table of one inverse depth a row: values_len floats, at least gedepth_core_rows_len. For cameras without
// distortion that hardly roll: GEDEPTH_CORE_ROLL_TOO_LARGE if a depth of up_to metres would be wrong by more than the share
// relative_error, GEDEPTH_CORE_NOT_FINITE if either is NaN.
int32_t gedepth_core_table_build_rows(const struct gedepth_core_camera *camera,
                                      double relative_error,
                                      double up_to,
                                      float *values,
                                      size_t values_len,
                                      struct gedepth_core_ground *ground);

// Makes the three coefficients of a camera without distortion, which need no memory.
int32_t gedepth_core_table_coefficients(const struct gedepth_core_camera *camera, struct gedepth_core_ground *ground);

// Keeps the ray of every pixel: rays_len floats, at least gedepth_core_rays_len. Needs the lens only. For
// gedepth_core_table_rebuild.
int32_t gedepth_core_rays_build(const struct gedepth_core_camera *camera, float *rays, size_t rays_len);

// Makes the table of inverse depths for a camera whose pitch, roll or height is new (gedepth_core_camera_set_mounting)
// and whose rays were kept, without unprojecting: rays_len exactly gedepth_core_rays_len, values_len at least
// gedepth_core_table_len. About 1e-6 of the depth less exact than gedepth_core_table_build.
int32_t gedepth_core_table_rebuild(const struct gedepth_core_camera *camera,
                                   const float *rays,
                                   size_t rays_len,
                                   float *values,
                                   size_t values_len,
                                   struct gedepth_core_ground *ground);

// Writes the ground's depth in metres, 0 where there is none or where it is beyond max_depth, which is finite: metres_len floats, exactly
// width * height.
int32_t gedepth_core_ground_depth(const struct gedepth_core_ground *ground,
                                  float max_depth,
                                  float *metres,
                                  size_t metres_len);

// How much of the picture shows ground: its share of the pixels, 0 to 1, and the nearest ground in metres, 0 if there is
// none. scratch_len floats, at least the width.
int32_t gedepth_core_ground_coverage(const struct gedepth_core_ground *ground,
                                     float *scratch,
                                     size_t scratch_len,
                                     double *share,
                                     float *nearest);

// Elements of a table with a value a pixel; 0 for a picture size that is refused. Also GEDEPTH_CORE_TABLE_LEN.
size_t gedepth_core_table_len(uint32_t width, uint32_t height);

// Elements of a table with a value a row; 0 for a picture size that is refused. Also GEDEPTH_CORE_ROWS_LEN.
size_t gedepth_core_rows_len(uint32_t width, uint32_t height);

// Elements of kept rays; 0 for a picture size that is refused. Also GEDEPTH_CORE_RAYS_LEN.
size_t gedepth_core_rays_len(uint32_t width, uint32_t height);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* GEDEPTH_CORE_H */

/* The lengths as constants, for static memory; arguments as those of the functions of the same names. */
#define GEDEPTH_CORE_TABLE_LEN(width, height) ((size_t)(width) * (size_t)(height))
#define GEDEPTH_CORE_ROWS_LEN(width, height) ((size_t)(height))
#define GEDEPTH_CORE_RAYS_LEN(width, height) (2 * (size_t)(width) * (size_t)(height))
#define GEDEPTH_CORE_SCRATCH_LEN(width, height, head_width, slope_classes)                          \
  (9 * (size_t)(width) + 4 * (size_t)(head_width) +                                                 \
   ((slope_classes) > 0                                                                             \
        ? (2 * (size_t)(slope_classes) + 1) * (size_t)(width) +                                     \
              ((size_t)(slope_classes) + 1) * (size_t)(head_width) +                                \
              3 * ((size_t)(width) > (size_t)(head_width) ? (size_t)(width) : (size_t)(head_width)) \
        : 0))

#ifndef GEDEPTH_CORE_LAYOUT
#define GEDEPTH_CORE_LAYOUT
/* The compiler sees the structs as the library does. */
typedef char gedepth_core_check_camera[sizeof(gedepth_core_camera) == 512 ? 1 : -1];
typedef char gedepth_core_check_lens[sizeof(gedepth_core_lens) == 120 ? 1 : -1];
typedef char gedepth_core_check_extrinsics[sizeof(gedepth_core_extrinsics) == 128 ? 1 : -1];
typedef char gedepth_core_check_mounting[sizeof(gedepth_core_mounting) == 32 ? 1 : -1];
typedef char gedepth_core_check_line[sizeof(gedepth_core_line) == 32 ? 1 : -1];
typedef char gedepth_core_check_fusion[sizeof(gedepth_core_fusion) == 16 ? 1 : -1];
#endif
