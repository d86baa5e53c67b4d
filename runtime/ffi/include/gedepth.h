/*
 * Metric depth from one camera picture and its calibration: GEDepth (ICCV 2023) on the CPU.
 * Made by cbindgen from runtime/ffi/src; do not edit. How to link it and what to expect of it: runtime/ffi/README.md.
 *
 * - A model and a calibration make a camera; that takes pictures and writes depth into the caller's memory.
 * - Lengths and strides are numbers of ELEMENTS, never bytes (of a picture they are the same). index = v * stride + u.
 * - Every function that returns int32_t checks pointers (null, alignment), lengths, overlap of what it writes with all
 *   else, and every number, and returns one of the numbered results; gedepth_last_error() says more. What it writes is
 *   written on GEDEPTH_OK only, and by gedepth_camera_run on GEDEPTH_DEADLINE too. Unused and reserved fields must be 0.
 * - Threads: any function may be called from any thread. A model may be used by several at once. A camera serves one call
 *   at a time; another meanwhile gives GEDEPTH_BUSY. Nothing may be in use by another call when it is closed.
 * - The caller's part: pointers that are not null lead to that many elements, used by nobody else until the call returns,
 *   and handles come from this library and were not closed.
 */

#ifndef GEDEPTH_H
#define GEDEPTH_H

#include <stddef.h>
#include <stdint.h>

// The version of the binary interface: changes when something that was is no more, or means something else.
// Additions do not change it.
#define GEDEPTH_ABI_VERSION 1

// No distortion.
#define GEDEPTH_PINHOLE 1

// Brown-Conrady: k1, k2, p1, p2, k3, and k4, k5, k6 of the rational form or 0; OpenCV's order, ROS `plumb_bob` and
// `rational_polynomial`.
#define GEDEPTH_BROWN_CONRADY 2

// Kannala-Brandt fisheye: k1, k2, k3, k4; OpenCV `fisheye`, ROS `equidistant`.
#define GEDEPTH_KANNALA_BRANDT 3

// Maps have the picture's size (the region's, where the model crops): the ground is exact in every pixel.
#define GEDEPTH_OUTPUT_PICTURE 0

// Maps have the network's size: fewer pixels, faster.
#define GEDEPTH_OUTPUT_NETWORK 1

// Red, green, blue.
#define GEDEPTH_FORMAT_RGB 0

// Blue, green, red.
#define GEDEPTH_FORMAT_BGR 1

// Red, green, blue, and a byte that is not read.
#define GEDEPTH_FORMAT_RGBX 2

// Blue, green, red, and a byte that is not read.
#define GEDEPTH_FORMAT_BGRX 3

// One grey value.
#define GEDEPTH_FORMAT_GREY 4

// Two pixels in four bytes: luma, Cb, luma, Cr.
#define GEDEPTH_FORMAT_YUYV 5

// Two pixels in four bytes: Cb, luma, Cr, luma.
#define GEDEPTH_FORMAT_UYVY 6

// A plane of luma, then one of Cb, Cr with a pair for every two by two pixels.
#define GEDEPTH_FORMAT_NV12 7

// ITU-R BT.601, luma 16 to 235, chroma 16 to 240.
#define GEDEPTH_YUV_BT601_LIMITED 0

// ITU-R BT.601, 0 to 255 (JFIF).
#define GEDEPTH_YUV_BT601_FULL 1

// ITU-R BT.709, luma 16 to 235, chroma 16 to 240.
#define GEDEPTH_YUV_BT709_LIMITED 2

// ITU-R BT.709, 0 to 255.
#define GEDEPTH_YUV_BT709_FULL 3

// The fastest kernels that this processor has; tract where they would be the portable ones.
#define GEDEPTH_KERNEL_BEST 0

// tract, the reference: slower; its number of threads is one.
#define GEDEPTH_KERNEL_TRACT 1

// Plain code, for any processor: slower than tract.
#define GEDEPTH_KERNEL_PORTABLE 2

// x86-64 with AVX2.
#define GEDEPTH_KERNEL_AVX2 3

// x86-64 with AVX-VNNI.
#define GEDEPTH_KERNEL_AVX_VNNI 4

// x86-64 with AVX-512 VNNI.
#define GEDEPTH_KERNEL_AVX512_VNNI 5

// AArch64.
#define GEDEPTH_KERNEL_NEON 6

// AArch64 with the dot product.
#define GEDEPTH_KERNEL_NEON_DOTPROD 7

// AArch64 with 8-bit matrix products.
#define GEDEPTH_KERNEL_NEON_I8MM 8

// Done.
#define GEDEPTH_OK 0

// A pointer that must not be null is.
#define GEDEPTH_NULL_POINTER 1

// A pointer is not aligned for its type.
#define GEDEPTH_MISALIGNED 2

// Memory that is written overlaps other memory of the same call.
#define GEDEPTH_OVERLAP 3

// An array is longer than memory.
#define GEDEPTH_TOO_LONG 4

// A number that chooses among named values is none of them.
#define GEDEPTH_UNKNOWN_CHOICE 7

// Something that is not used must be 0 and is not.
#define GEDEPTH_UNUSED_NOT_ZERO 8

// The run took longer than its deadline. Its maps and its report are complete, and the next run is sound.
#define GEDEPTH_DEADLINE 30

// This processor does not have the kernel's instructions.
#define GEDEPTH_KERNEL_NOT_SUPPORTED 31

// More than 64 threads.
#define GEDEPTH_THREADS 32

// The attention is asked for, but the model has none.
#define GEDEPTH_NO_ATTENTION 33

// Another thread is using the camera. Nothing was done.
#define GEDEPTH_BUSY 34

// A fault of this library, caught. A camera that it happened in gives this ever after: close it.
#define GEDEPTH_PANICKED 35

// A picture's bytes are fewer than its size and stride need, or its stride is shorter than a row.
#define GEDEPTH_PICTURE_LENGTH 36

// A path is not UTF-8, on a system where it must be.
#define GEDEPTH_PATH 37

// The statistics would keep more than 1000000 runs.
#define GEDEPTH_STATISTICS_LENGTH 38

// A picture has no pixel, or a side longer than 65535.
#define GEDEPTH_IMAGE_SIZE 101

// Focal length.
#define GEDEPTH_FOCAL_LENGTH 102

// Principal point.
#define GEDEPTH_PRINCIPAL_POINT 103

// Skew.
#define GEDEPTH_SKEW 104

// K of a file is not [fx s cx; 0 fy cy; 0 0 1].
#define GEDEPTH_INTRINSIC_MATRIX 105

// Distortion coefficient.
#define GEDEPTH_DISTORTION_COEFFICIENT 106

// The plane's normal has no direction.
#define GEDEPTH_DIRECTION_WITHOUT_LENGTH 201

// R is no rotation.
#define GEDEPTH_NOT_A_ROTATION 202

// R mirrors.
#define GEDEPTH_REFLECTION 203

// Translation.
#define GEDEPTH_TRANSLATION 204

// An angle.
#define GEDEPTH_ANGLE_NOT_FINITE 205

// Offset of the ground plane.
#define GEDEPTH_PLANE_OFFSET 301

// Height over the ground.
#define GEDEPTH_CAMERA_NOT_ABOVE_GROUND 302

// A map is shorter than its size and stride need, or its stride is shorter than a row.
#define GEDEPTH_OUTPUT_LENGTH 607

// The picture has another size than the camera.
#define GEDEPTH_PICTURE_SIZE 803

// Pictures of this size do not fit the network, or have a side longer than 16384.
#define GEDEPTH_PICTURE_UNFIT 804

// The network does not take the size that was asked for.
#define GEDEPTH_NETWORK_SIZE 805

// The camera's threads cannot be kept on these cores.
#define GEDEPTH_CORES 806

// A calibration file cannot be read.
#define GEDEPTH_CALIBRATION_READ 821

// A calibration file is malformed.
#define GEDEPTH_CALIBRATION_FORMAT 822

// A model file cannot be read.
#define GEDEPTH_MODEL_READ 841

// A model says nothing, or nonsense, about itself.
#define GEDEPTH_CONTRACT 842

// A model is not ONNX, or does not do what it says, or cannot be run.
#define GEDEPTH_MODEL 843

// A model bound to a calibrated camera. One thread at a time: a call during another of the same camera gives GEDEPTH_BUSY.
// Different cameras may run at the same time on different threads, and a camera need not stay with one thread.
typedef struct gedepth_camera gedepth_camera;

// A network and what it says about itself. Made by gedepth_model_open_*, never changed afterwards: any number of threads may
// open cameras with it at the same time. Cameras keep what they need of it; it may be closed before them.
typedef struct gedepth_model gedepth_model;

// A camera, where it is, and where the ground is. Pixels have integer coordinates at their centres, u right, v down:
// u = fx x + skew y + cx, v = fy y + cy. p_camera = R p_world + T in metres, the camera's frame x right, y down, z forward,
// the world's any; the ground is the plane n . p_world = plane_offset, n the unit vector along plane_up.
typedef struct gedepth_calibration {
  // Columns of the pictures, 1 to 16384; gedepth_calibration_read gives 0 where the file does not say.
  uint32_t width;
  // Rows, the same.
  uint32_t height;
  // GEDEPTH_PINHOLE, GEDEPTH_BROWN_CONRADY or GEDEPTH_KANNALA_BRANDT.
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
  // R, rows; orthonormal to 1e-3.
  double r[9];
  // T, metres, each within +-1e9.
  double t[3];
  // The plane's normal, of any length, pointing out of the ground.
  double plane_up[3];
  // Metres, within +-1e9.
  double plane_offset;
} gedepth_calibration;

// How a camera is opened; all zeros is the usual.
typedef struct gedepth_options {
  // Columns of the network's input; with network_height 0, the usual of the model and the picture's proportions. Both are
  // multiples of what the model asks for (32 of the shipped ones), at most 16384, and 2^24 pixels; or what the file is fixed to.
  uint32_t network_width;
  // Rows of the network's input.
  uint32_t network_height;
  // GEDEPTH_OUTPUT_PICTURE or GEDEPTH_OUTPUT_NETWORK.
  uint32_t output;
  // Runs that the statistics are of, the last ones: 1 to 1000000; 0 is 1000. 48 bytes each.
  uint32_t statistics_runs;
  // 0.
  uint32_t reserved[4];
} gedepth_options;

// Sizes of an opened camera, in pixels, and what it gives.
typedef struct gedepth_shape {
  // Columns of the pictures.
  uint32_t picture_width;
  // Rows of the pictures.
  uint32_t picture_height;
  // First column of the region of the picture that the maps cover.
  uint32_t region_left;
  // First row of the region.
  uint32_t region_top;
  // Columns of the region.
  uint32_t region_width;
  // Rows of the region.
  uint32_t region_height;
  // Columns of the network's input.
  uint32_t network_width;
  // Rows of the network's input.
  uint32_t network_height;
  // Columns of the maps.
  uint32_t map_width;
  // Rows of the maps.
  uint32_t map_height;
  // 1 if there is an attention, 0 if not.
  uint32_t has_attention;
  // 0.
  uint32_t reserved;
} gedepth_shape;

// A picture, 8 bits a value, row by row from the top left; read where it is, without a copy. What is not used is 0: of a picture
// of red, green, blue, all from `format` on.
typedef struct gedepth_picture {
  // The bytes; of GEDEPTH_FORMAT_NV12 the luma.
  const uint8_t *bytes;
  // Their number, at least (height - 1) * stride + a row's.
  size_t bytes_len;
  // Bytes from the start of a row to the start of the next, at least a row's; 0 is a row's: width times 3, 4 (RGBX, BGRX), 1
  // (GREY, NV12), or 2 (YUYV, UYVY; of the next even width).
  size_t stride;
  // Columns: the camera's.
  uint32_t width;
  // Rows: the camera's.
  uint32_t height;
  // GEDEPTH_FORMAT_*.
  uint32_t format;
  // What luma and chroma are, where the format has them: GEDEPTH_YUV_*.
  uint32_t yuv;
  // Chroma of GEDEPTH_FORMAT_NV12: half as many rows, rounded up.
  const uint8_t *chroma;
  // Number of its bytes, at least (rows - 1) * chroma_stride + a row's.
  size_t chroma_len;
  // As stride; a row has as many bytes as the next even width.
  size_t chroma_stride;
} gedepth_picture;

// A map to be written, row by row from the top left; with values null and values_len 0, none.
typedef struct gedepth_map {
  // The values.
  float *values;
  // Their number, at least (map_height - 1) * stride + map_width.
  size_t values_len;
  // Values from the start of a row to the start of the next, at least map_width; 0 is map_width. What lies between rows is
  // left as it is.
  size_t stride;
} gedepth_map;

// What a run is to write. Every map may be null. Ground or attention take a second fusion, in the time for copying.
typedef struct gedepth_maps {
  // Planar depth, metres: z in the camera's frame. Within the model's range, never 0: its end for sky and what is farther.
  struct gedepth_map depth;
  // Ground depth as the model sees it, metres; 0 where there is none within the model's range.
  struct gedepth_map ground;
  // Ground attention, 0 to 1: how much of the depth is the ground's.
  struct gedepth_map attention;
} gedepth_maps;

// How long a run took, nanoseconds.
typedef struct gedepth_times {
  // Resampling of the picture.
  uint64_t preprocess_ns;
  // The network.
  uint64_t network_ns;
  // From the network's outputs to depth.
  uint64_t fusion_ns;
  // Copies into the caller's maps.
  uint64_t copy_ns;
  // The call, from its start to when its maps were written.
  uint64_t total_ns;
} gedepth_times;

// Of a stage, nanoseconds.
typedef struct gedepth_percentiles {
  // At least half of the runs took at most this.
  uint64_t p50_ns;
  // At least 99 of 100 runs took at most this.
  uint64_t p99_ns;
  // No run took longer.
  uint64_t max_ns;
} gedepth_percentiles;

// The times of a camera's last runs; all 0 before the first.
typedef struct gedepth_statistics {
  // Runs since the camera was opened that gave depth, late or not.
  uint64_t runs;
  // Those of them that took longer than their deadline.
  uint64_t late;
  // How many of the last runs the percentiles are of.
  uint64_t window;
  // Resampling of the picture.
  struct gedepth_percentiles preprocess;
  // The network.
  struct gedepth_percentiles network;
  // From the network's outputs to depth.
  struct gedepth_percentiles fusion;
  // Copies into the caller's maps.
  struct gedepth_percentiles copy;
  // The call, from its start to when its maps were written.
  struct gedepth_percentiles total;
} gedepth_statistics;

// Signs that a calibration and what a picture shows do not belong together, for a monitor to watch over many pictures.
// An input to a safety argument, not one: each can be right by chance, and none sees every fault. -1 where there is no
// such pixel, or no attention.
typedef struct gedepth_plausibility {
  // Share of the maps' pixels where the calibration has ground within the model's range. The same for every picture until
  // gedepth_camera_set_ground.
  float ground_share;
  // Share of those where the ground is trusted: the attention is at least 1/2. It falls when the ground is hidden or wet,
  // the lens is dirty, or the calibration is of another camera.
  float trusted_share;
  // Mean attention about the vanishing line, where the ground is farther than the model's range, above the line as
  // below. There is no ground to trust there: it rises when the camera's pitch is not the calibration's.
  float attention_at_line;
  // Mean of |z - z_table| / z_table where the ground is trusted, z the depth, z_table the flat ground's: slope of the road,
  // or a wrong pitch or height.
  float ground_residual;
} gedepth_plausibility;

// The ground as a camera sees it.
typedef struct gedepth_ground {
  // The direction straight down to it, in the camera's frame: x right, y down, z forward. Of any length; the library writes
  // unit vectors.
  double down[3];
  // The camera's height over it, metres, 0.001 to 1e5.
  double height;
} gedepth_ground;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// The library's GEDEPTH_ABI_VERSION; compare it with the header's before the first call.
uint32_t gedepth_abi_version(void);

// The library's version, "major.minor.patch", in static memory.
const char *gedepth_version(void);

// Reads a calibration file and checks it: this project's JSON, or KITTI's (object, tracking, odometry; of raw the path of
// calib_cam_to_cam.txt, beside which calib_velo_to_cam.txt is). KITTI's do not say where the ground is: it is 1.65 m below the
// LiDAR then, and the camera is number 2. `path` ends with a zero. Where the file has no size of
// pictures (KITTI but raw), width and height are 0, for the caller to fill in.
int32_t gedepth_calibration_read(const char *path,
                                 struct gedepth_calibration *calibration);

// Binds a model to a calibrated camera: plans the network, builds the ground table and runs a made-up picture, so that all
// memory of later runs is there. Takes some 50 ms with the shipped models, up to 1 s where tract runs the model. `options`
// may be null: the usual. `*camera` is written on success only. For another lens or place open another camera, then close
// this one; another ground under it is gedepth_camera_set_ground's.
int32_t gedepth_camera_open(const struct gedepth_model *model,
                            const struct gedepth_calibration *calibration,
                            const struct gedepth_options *options,
                            struct gedepth_camera **camera);

// The camera's sizes, for the caller to make its maps.
int32_t gedepth_camera_shape(const struct gedepth_camera *camera, struct gedepth_shape *shape);

// Estimates the depth of a picture and writes the maps that are not null. `times` may be null. Where the run takes longer
// than `deadline_ns` (0 is none) the result is GEDEPTH_DEADLINE, with everything written; a run is never cut short. After
// any other result but GEDEPTH_OK nothing was written. Allocates nothing where the quantized engine runs the whole network.
int32_t gedepth_camera_run(struct gedepth_camera *camera,
                           const struct gedepth_picture *picture,
                           const struct gedepth_maps *maps,
                           uint64_t deadline_ns,
                           struct gedepth_times *times);

// Percentiles of the camera's last runs. Allocates nothing.
int32_t gedepth_camera_statistics(const struct gedepth_camera *camera, struct gedepth_statistics *statistics);

// What the camera's last picture says about its calibration (before the first, of a made-up one). Allocates nothing; takes
// less than 1 ms for a megapixel of maps, and a fusion where the picture's maps were not asked for.
int32_t gedepth_camera_plausibility(const struct gedepth_camera *camera,
                                    struct gedepth_plausibility *plausibility);

// Keeps each of a camera's threads on one of these cores (numbers as Linux has them), in order, from the first again if there are
// more threads. The calling thread is the first of them: call this on the one that runs the camera's pictures. GEDEPTH_CORES where
// tract runs a part of the network, there are no cores, or the system refuses one; threads may then be on others of these cores.
int32_t gedepth_camera_pin(struct gedepth_camera *camera,
                           const uint32_t *cores,
                           size_t cores_len);

// Closes a camera and ends its threads; null is none. No other call may be using it.
void gedepth_camera_close(struct gedepth_camera *camera);

// The ground that R, T and the plane of a calibration give; the camera and its lens are not looked at.
int32_t gedepth_ground_of_calibration(const struct gedepth_calibration *calibration, struct gedepth_ground *ground);

// The ground `height` metres (0.001 to 1e5) under a camera that looks along the ground, but for `pitch` (positive looks down) and
// then `roll` (positive lowers the right side), both in radians.
int32_t gedepth_ground_of_mounting(double height,
                                   double pitch,
                                   double roll,
                                   struct gedepth_ground *ground);

// The ground that the camera's next picture is fused with. Allocates nothing.
int32_t gedepth_camera_ground(const struct gedepth_camera *camera, struct gedepth_ground *ground);

// The same camera over another ground, from its next picture on: a vehicle pitches, and its springs give under a load. Depth is
// then that of a camera opened with this ground. Until a picture has run, gedepth_camera_plausibility is the last one's
// heads over the new ground. Allocates nothing; takes 2 to 3 % of the time of a picture, with a lens 7.
int32_t gedepth_camera_set_ground(struct gedepth_camera *camera,
                                  const struct gedepth_ground *ground);

// Opens the quantized adaptive model inside the library. `kernel` is one of GEDEPTH_KERNEL_*; `threads` the number of
// threads of each camera's network, the caller's included, 0 for the usual (2, or 1 on one core). The depth does not
// depend on either, but for GEDEPTH_KERNEL_TRACT, which rounds in another order. `*model` is written on success only.
int32_t gedepth_model_open_embedded(uint32_t kernel, uint32_t threads, struct gedepth_model **model);

// Opens an ONNX file with a contract in its metadata. `path` ends with a zero; the rest as gedepth_model_open_embedded.
int32_t gedepth_model_open_file(const char *path, uint32_t kernel, uint32_t threads, struct gedepth_model **model);

// Opens the bytes of an ONNX file, which are not needed afterwards; the rest as gedepth_model_open_embedded.
int32_t gedepth_model_open_memory(const uint8_t *bytes,
                                  size_t bytes_len,
                                  uint32_t kernel,
                                  uint32_t threads,
                                  struct gedepth_model **model);

// Closes a model; null is none. No other call may be using it.
void gedepth_model_close(struct gedepth_model *model);

// What a result means, in English, in static memory; never null.
const char *gedepth_result_text(int32_t result);

// What was wrong with which value in the last call of this thread that failed, in English, UTF-8, at most 511 bytes;
// empty if none did. Never null. The memory is the thread's: valid until its next call that fails, or its end.
const char *gedepth_last_error(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* GEDEPTH_H */

#ifndef GEDEPTH_LAYOUT
#define GEDEPTH_LAYOUT
/* The compiler sees the structs as the library does. */
typedef char gedepth_check_calibration[sizeof(gedepth_calibration) == 248 ? 1 : -1];
typedef char gedepth_check_ground[sizeof(gedepth_ground) == 32 ? 1 : -1];
typedef char gedepth_check_options[sizeof(gedepth_options) == 32 ? 1 : -1];
typedef char gedepth_check_shape[sizeof(gedepth_shape) == 48 ? 1 : -1];
typedef char gedepth_check_picture[sizeof(gedepth_picture) == 6 * sizeof(size_t) + 16 ? 1 : -1];
typedef char gedepth_check_maps[sizeof(gedepth_maps) == 9 * sizeof(size_t) ? 1 : -1];
typedef char gedepth_check_plausibility[sizeof(gedepth_plausibility) == 16 ? 1 : -1];
typedef char gedepth_check_times[sizeof(gedepth_times) == 40 ? 1 : -1];
typedef char gedepth_check_statistics[sizeof(gedepth_statistics) == 144 ? 1 : -1];
#endif
