#include "vectors.h"

#include "gedepth_core.h"

float table_memory[WIDTH * HEIGHT], map_memory[WIDTH * HEIGHT];

static int failures;

void print_hex(const char *name, uint64_t value, int digits) {
  char line[64];
  size_t end = 0;
  while (*name && end < sizeof line - 20) line[end++] = *name++;
  line[end++] = ' ';
  for (int digit = digits - 1; digit >= 0; digit--) line[end++] = "0123456789abcdef"[value >> (4 * digit) & 15];
  line[end] = 0;
  write_line(line);
}

static void print_double(const char *name, double value) {
  union {
    double number;
    uint64_t bits;
  } both = {value};
  print_hex(name, both.bits, 16);
}

static void print_float(const char *name, float value) {
  union {
    float number;
    uint32_t bits;
  } both = {value};
  print_hex(name, both.bits, 8);
}

/* FNV-1a over the elements' bytes, lowest first. */
static void print_sum(const char *name, const void *values, size_t count, size_t size) {
  const unsigned char *bytes = values;
  uint32_t sum = 0x811c9dc5u;
  for (size_t i = 0; i < count * size; i++) sum = (sum ^ bytes[i]) * 0x01000193u;
  print_hex(name, sum, 8);
}

static void ok(const char *name, int32_t result) {
  if (result == GEDEPTH_CORE_OK) return;
  failures++;
  print_hex(name, (uint64_t)result, 8);
  write_line(gedepth_core_result_text(result));
}

void noise(float *values, size_t count, uint32_t seed, float scale, float offset) {
  for (size_t i = 0; i < count; i++) {
    seed = seed * 1664525u + 1013904223u;
    values[i] = (float)(seed >> 8) * (1.0f / 16777216.0f) * scale + offset;
  }
}

static void print_ground(const char *name, const gedepth_core_camera *camera) {
  double down[3], height;
  gedepth_core_line line = {0, 0, 0, 0};
  ok(name, gedepth_core_camera_ground(camera, &down, &height));
  for (int i = 0; i < 3; i++) print_double(name, down[i]);
  print_double(name, height);
  int32_t result = gedepth_core_vanishing_line(camera, &line);
  print_hex(name, (uint64_t)result, 2);
  print_double(name, line.u0);
  print_double(name, line.v0);
  print_double(name, line.u1);
  print_double(name, line.v1);
}

static void print_depth(const char *name, const gedepth_core_ground *ground) {
  size_t pixels = gedepth_core_table_len(ground->width, ground->height);
  ok(name, gedepth_core_ground_depth(ground, 80.0f, map_memory, pixels));
  print_sum(name, map_memory, pixels, sizeof(float));
  double share;
  float nearest;
  ok(name, gedepth_core_ground_coverage(ground, map_memory, ground->width, &share, &nearest));
  print_double(name, share);
  print_float(name, nearest);
}

/* KITTI 2011_09_26: K of P2, and R, T with K [R T] = P2 R0_rect Tr_velo_to_cam; the LiDAR's z points up. */
static void kitti(void) {
  static const gedepth_core_lens lens = {WIDTH, HEIGHT, GEDEPTH_CORE_PINHOLE, 0, 721.5377, 721.5377, 609.5593, 172.854,
                                         0.0,   {0}};
  static const gedepth_core_extrinsics pose = {
      {2.3477369814704142e-4, -9.999441545437641e-1, -1.0563477811052201e-2, 1.0449407416592844e-2,
       1.056535364137932e-2, -9.99889574117649e-1, 9.999453885620024e-1, 1.2436537838650679e-4,
       1.0451302995668946e-2},
      {0.05705244785953045, -0.07546671853346003, -0.2693869124058732},
      {0.0, 0.0, 1.0},
      -1.65};
  /* Row, column, and the depth that the reference implementation gives; negative above the vanishing line. */
  static const double reference[9][3] = {
      {0, 0, -6.094572064317271},      {374, 0, 6.083866742255532},      {374, 1236, 5.687095107975469},
      {180, 600, -2291.8808081202255}, {176, 1200, 618.1934695618058},   {172, 0, -76.7533254636052},
      {173, 0, -82.30084173228032},    {175, 0, -96.20815604361277},     {250, 618, 16.338480985480373}};
  static gedepth_core_camera camera;
  gedepth_core_ground ground;
  ok("kitti.lens", gedepth_core_camera_set_lens(&camera, &lens));
  ok("kitti.pose", gedepth_core_camera_set_extrinsics(&camera, &pose));
  print_ground("kitti.ground", &camera);
  for (int i = 0; i < 9; i++) {
    double inverse, depth = reference[i][2];
    ok("kitti.at", gedepth_core_inverse_depth_at(&camera, reference[i][1], reference[i][0], &inverse));
    print_double("kitti.at", inverse);
    double size = depth < 0 ? -depth : depth, difference = inverse - 1.0 / depth;
    if (difference < 0) difference = -difference;
    if (difference > 1e-5 / (size < 200 ? size : 200)) ok("kitti.reference", -1);
  }
  ok("kitti.table", gedepth_core_table_build(&camera, table_memory, WIDTH * HEIGHT, &ground));
  print_sum("kitti.table", table_memory, WIDTH * HEIGHT, sizeof(float));
  print_depth("kitti.depth", &ground);
  uint16_t *metres = (uint16_t *)(void *)table_memory;
  ok("kitti.metres", gedepth_core_table_build_metres(&camera, metres, WIDTH * HEIGHT, &ground));
  print_sum("kitti.metres", metres, WIDTH * HEIGHT, sizeof *metres);
  print_depth("kitti.metres", &ground);
  ok("kitti.coefficients", gedepth_core_table_coefficients(&camera, &ground));
  for (int i = 0; i < 3; i++) print_double("kitti.coefficients", ground.coefficients[i]);
  print_depth("kitti.coefficients", &ground);
  static const gedepth_core_mounting mounting = {1.65, 0.01, 0.0, 0.5};
  ok("kitti.mounting", gedepth_core_camera_set_mounting(&camera, &mounting));
  print_ground("kitti.mounting", &camera);
  ok("kitti.rows", gedepth_core_table_build_rows(&camera, 1e-3, 80.0, table_memory, HEIGHT, &ground));
  print_sum("kitti.rows", table_memory, HEIGHT, sizeof(float));
  print_depth("kitti.rows", &ground);
}

/* A lens of each kind with skew, pitched and rolled, then loaded: the rays are kept. */
static void lenses(void) {
  static const gedepth_core_lens lens[4] = {
      {160, 120, GEDEPTH_CORE_PINHOLE, 0, 150.0, 149.0, 80.5, 58.25, 0.75, {0}},
      {160, 120, GEDEPTH_CORE_BROWN_CONRADY, 0, 150.0, 149.0, 80.5, 58.25, 0.75, {-0.28, 0.09, 1e-3, -5e-4, -0.012}},
      {160,
       120,
       GEDEPTH_CORE_BROWN_CONRADY,
       0,
       150.0,
       149.0,
       80.5,
       58.25,
       0.0,
       {0.5, -0.02, 1e-3, -5e-4, 1e-3, 0.8, 0.05, -1e-3}},
      {160, 120, GEDEPTH_CORE_KANNALA_BRANDT, 0, 60.0, 59.5, 80.5, 58.25, 0.0, {-0.02, 4e-3, -1e-3, 1e-4}}};
  static const gedepth_core_mounting mounting = {1.5, 0.05, 0.03, -0.2}, loaded = {1.45, 0.035, 0.025, 0.0};
  static const char *const name[4] = {"pinhole", "brown-conrady", "rational", "kannala-brandt"};
  static gedepth_core_camera camera;
  gedepth_core_ground ground;
  float *rays = map_memory;
  for (int i = 0; i < 4; i++) {
    ok(name[i], gedepth_core_camera_set_lens(&camera, &lens[i]));
    ok(name[i], gedepth_core_camera_set_mounting(&camera, &mounting));
    print_ground(name[i], &camera);
    ok(name[i], gedepth_core_table_build(&camera, table_memory, 160 * 120, &ground));
    print_sum(name[i], table_memory, 160 * 120, sizeof(float));
    ok(name[i], gedepth_core_camera_set_mounting(&camera, &loaded));
    ok(name[i], gedepth_core_rays_build(&camera, rays, gedepth_core_rays_len(160, 120)));
    print_sum(name[i], rays, gedepth_core_rays_len(160, 120), sizeof(float));
    ok(name[i], gedepth_core_table_rebuild(&camera, rays, gedepth_core_rays_len(160, 120), table_memory, 160 * 120,
                                           &ground));
    print_sum(name[i], table_memory, 160 * 120, sizeof(float));
    print_depth(name[i], &ground);
  }
}

enum { OUT_W = 148, OUT_H = 36, HEAD_W = 37, HEAD_H = 9, HEAD = HEAD_W * HEAD_H, OUT = OUT_W * OUT_H, CLASSES = 11 };

static float scratch[GEDEPTH_CORE_SCRATCH_LEN(OUT_W, OUT_H, HEAD_W, CLASSES)];

static void slope_angles(double *radians) {
  for (int i = 0; i < CLASSES; i++) radians[i] = (i - 5) * 0.017453292519943295;
}

static void fusion(void) {
  static float residual[HEAD], attention[HEAD], logits[CLASSES * HEAD];
  static uint8_t residual_u8[HEAD];
  static int8_t logits_i8[CLASSES * HEAD];
  noise(residual, HEAD, 1, 4.0f, 0.5f);
  noise(attention, HEAD, 2, 12.0f, -6.0f);
  noise(logits, CLASSES * HEAD, 3, 8.0f, -4.0f);
  for (int i = 0; i < HEAD; i++) residual_u8[i] = (uint8_t)(residual[i] * 50.0f);
  for (int i = 0; i < CLASSES * HEAD; i++) logits_i8[i] = (int8_t)(logits[i] * 30.0f);
  double radians[CLASSES];
  slope_angles(radians);
  const gedepth_core_slope_classes classes = {radians, CLASSES, GEDEPTH_CORE_UPHILL_POSITIVE, 0};
  const gedepth_core_lens lens = {
      OUT_W, OUT_H, GEDEPTH_CORE_BROWN_CONRADY, 0, 86.0, 86.0, 73.5, 17.5, 0.0, {-0.1, 0.01}};
  const gedepth_core_lens undistorted = {OUT_W, OUT_H, GEDEPTH_CORE_PINHOLE, 0, 86.0, 86.0, 73.5, 17.5, 0.0, {0}};
  const gedepth_core_mounting mounting = {1.65, 0.02, 0.0, 0.0};
  gedepth_core_camera camera = {{0}};
  gedepth_core_ground ground[4];
  float rows[OUT_H];
  uint16_t *metres = (uint16_t *)(void *)(table_memory + OUT);
  ok("fusion.lens", gedepth_core_camera_set_lens(&camera, &lens));
  ok("fusion.mounting", gedepth_core_camera_set_mounting(&camera, &mounting));
  ok("fusion.table", gedepth_core_table_build(&camera, table_memory, OUT, &ground[0]));
  ok("fusion.metres", gedepth_core_table_build_metres(&camera, metres, OUT, &ground[1]));
  ok("fusion.lens", gedepth_core_camera_set_lens(&camera, &undistorted));
  ok("fusion.mounting", gedepth_core_camera_set_mounting(&camera, &mounting));
  ok("fusion.rows", gedepth_core_table_build_rows(&camera, 1e-6, 80.0, rows, OUT_H, &ground[2]));
  ok("fusion.coefficients", gedepth_core_table_coefficients(&camera, &ground[3]));
  const gedepth_core_maps maps = {map_memory, OUT, map_memory + OUT, OUT, map_memory + 2 * OUT, OUT};
  const gedepth_core_maps depth_only = {map_memory, OUT, NULL, 0, NULL, 0};
  for (uint32_t at = GEDEPTH_CORE_DECODE_AT_HEAD; at <= GEDEPTH_CORE_DECODE_AT_OUTPUT; at++)
    for (uint32_t upsampling = GEDEPTH_CORE_HALF_PIXEL; upsampling <= GEDEPTH_CORE_ALIGN_CORNERS; upsampling++) {
      const gedepth_core_fusion settings = {upsampling, 0.1f, 80.0f, 150.0f};
      const gedepth_core_head residual_head = {
          residual, HEAD, GEDEPTH_CORE_F32, 1, HEAD_W, HEAD_H, GEDEPTH_CORE_LOG_METRES, at, 0.0f, 0, 0.0f};
      const gedepth_core_head residual_per_pixel_head = {residual, HEAD, GEDEPTH_CORE_F32, 1, HEAD_W, HEAD_H,
                                                          GEDEPTH_CORE_LOG_METRES_PER_PIXEL, at, 0.0f, 0, 5.5f};
      const gedepth_core_head residual_u8_head = {
          residual_u8, HEAD, GEDEPTH_CORE_U8, 1, HEAD_W, HEAD_H, GEDEPTH_CORE_METRES, at, 0.3f, 7, 0.0f};
      const gedepth_core_head attention_head = {
          attention, HEAD, GEDEPTH_CORE_F32, 1, HEAD_W, HEAD_H, GEDEPTH_CORE_LOGIT, at, 0.0f, 0, 0.0f};
      const gedepth_core_head slope_head = {
          logits, CLASSES * HEAD, GEDEPTH_CORE_F32, CLASSES, HEAD_W, HEAD_H, GEDEPTH_CORE_LOGIT, at, 0.0f, 0, 0.0f};
      const gedepth_core_head slope_i8_head = {
          logits_i8, CLASSES * HEAD, GEDEPTH_CORE_I8, CLASSES, HEAD_W, HEAD_H, GEDEPTH_CORE_LOGIT, at, 0.033f, -3, 0.0f};
      size_t needed = gedepth_core_scratch_len(OUT_W, OUT_H, HEAD_W, CLASSES);
      ok("baseline", gedepth_core_fuse_baseline(&settings, OUT_W, OUT_H, &residual_head, scratch, needed, map_memory, OUT));
      print_sum("baseline", map_memory, OUT, sizeof(float));
      ok("baseline.u8",
         gedepth_core_fuse_baseline(&settings, OUT_W, OUT_H, &residual_u8_head, scratch, needed, map_memory, OUT));
      print_sum("baseline.u8", map_memory, OUT, sizeof(float));
      ok("baseline.per_pixel",
         gedepth_core_fuse_baseline(&settings, OUT_W, OUT_H, &residual_per_pixel_head, scratch, needed, map_memory, OUT));
      print_sum("baseline.per_pixel", map_memory, OUT, sizeof(float));
      for (int i = 0; i < 4; i++) {
        ok("vanilla", gedepth_core_fuse_vanilla(&settings, &ground[i], &residual_head, &attention_head, scratch, needed,
                                                &maps));
        print_sum("vanilla", map_memory, 3 * OUT, sizeof(float));
        ok("adaptive", gedepth_core_fuse_adaptive(&settings, &ground[i], &residual_head, &attention_head, &slope_head,
                                                  &classes, scratch, needed, &maps));
        print_sum("adaptive", map_memory, 3 * OUT, sizeof(float));
      }
      ok("adaptive.i8", gedepth_core_fuse_adaptive(&settings, &ground[0], &residual_u8_head, &attention_head,
                                                   &slope_i8_head, &classes, scratch, needed, &depth_only));
      print_sum("adaptive.i8", map_memory, OUT, sizeof(float));
    }
  float expected;
  uint32_t nearest;
  double slope, inverse;
  ok("slope.expected", gedepth_core_expected_slope(&classes, logits, CLASSES, &expected));
  print_float("slope.expected", expected);
  ok("slope.nearest", gedepth_core_nearest_slope_class(&classes, expected, &nearest));
  print_hex("slope.nearest", nearest, 2);
  ok("slope.from-depth", gedepth_core_slope_from_depth(&camera, 0.05, 21.0, &slope));
  print_double("slope.from-depth", slope);
  ok("slope.inverse", gedepth_core_sloped_inverse_depth(&camera, 0.05, slope, &inverse));
  print_double("slope.inverse", inverse);
}

int vectors(void) {
  failures = 0;
  if (gedepth_core_abi_version() != GEDEPTH_CORE_ABI_VERSION) ok("abi", -1);
  if (gedepth_core_table_len(1242, 375) != GEDEPTH_CORE_TABLE_LEN(1242, 375) ||
      gedepth_core_rows_len(1242, 375) != GEDEPTH_CORE_ROWS_LEN(1242, 375) ||
      gedepth_core_rays_len(1242, 375) != GEDEPTH_CORE_RAYS_LEN(1242, 375) ||
      gedepth_core_scratch_len(1242, 375, 311, 0) != GEDEPTH_CORE_SCRATCH_LEN(1242, 375, 311, 0) ||
      gedepth_core_scratch_len(1242, 375, 311, 11) != GEDEPTH_CORE_SCRATCH_LEN(1242, 375, 311, 11) ||
      gedepth_core_scratch_len(300, 375, 311, 11) != GEDEPTH_CORE_SCRATCH_LEN(300, 375, 311, 11))
    ok("lengths", -1);
  kitti();
  lenses();
  fusion();
  return failures;
}
