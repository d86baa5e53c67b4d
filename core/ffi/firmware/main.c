/* The vectors on a microcontroller, then what the entries cost: stack and instructions. */
#include "board.h"
#include "gedepth_core.h"
#include "vectors.h"

void write_line(const char *line) {
  board_write(line);
  board_write("\n");
}

static void print_number(const char *name, uint32_t value) {
  char digits[12];
  int start = sizeof digits - 1;
  digits[start] = 0;
  do digits[--start] = (char)('0' + value % 10);
  while (value /= 10);
  board_write(name);
  board_write(digits + start);
}

#define PAINT 0x5ca1ab1eu

/* Bytes that no entry may exceed: core/ffi/README.md. */
#define STACK_LIMIT 4096u

/* Never inlined: what `job` needs lies below this frame. */
__attribute__((noinline)) static void measure(const char *name, uint32_t width, uint32_t height, int32_t (*job)(void)) {
  const char *here;
  __asm__ volatile("mov %0, sp" : "=r"(here));
  for (volatile uint32_t *word = stack_end; (const char *)word < here; word++) *word = PAINT;
  uint32_t before = board_clock();
  int32_t result = job();
  uint32_t count = board_elapsed(before);
  const volatile uint32_t *word = stack_end;
  while (*word == PAINT) word++;
  uint32_t pixels = width * height, stack = (uint32_t)(here - (const char *)word);
  board_write(name);
  print_number(" ", width);
  print_number("x", height);
  print_number(": ", count);
  print_number(" instructions, ", count / pixels);
  print_number(" a pixel, stack ", stack);
  write_line(result != GEDEPTH_CORE_OK ? " bytes, FAILED" : stack > STACK_LIMIT ? " bytes, TOO MUCH" : " bytes");
  if (result != GEDEPTH_CORE_OK || stack > STACK_LIMIT) board_exit(2);
}

static gedepth_core_camera camera;
static gedepth_core_ground ground;
static gedepth_core_lens lens;
static const gedepth_core_mounting mounting = {1.5, 0.05, 0.0, 0.0};
static uint32_t W, H;

static int32_t set_lens(void) { return gedepth_core_camera_set_lens(&camera, &lens); }
static int32_t set_mounting(void) { return gedepth_core_camera_set_mounting(&camera, &mounting); }
static int32_t table(void) { return gedepth_core_table_build(&camera, table_memory, (size_t)W * H, &ground); }
static int32_t metres(void) {
  return gedepth_core_table_build_metres(&camera, (uint16_t *)(void *)map_memory, (size_t)W * H, &ground);
}
static int32_t rows(void) {
  return gedepth_core_table_build_rows(&camera, 1e-3, 80.0, map_memory, (size_t)W * H, &ground);
}
static int32_t coefficients(void) { return gedepth_core_table_coefficients(&camera, &ground); }
static int32_t rays(void) { return gedepth_core_rays_build(&camera, map_memory, WIDTH * HEIGHT); }
static int32_t rebuild(void) {
  return gedepth_core_table_rebuild(&camera, map_memory, gedepth_core_rays_len(W, H), table_memory, (size_t)W * H, &ground);
}
static int32_t line(void) {
  gedepth_core_line ends;
  return gedepth_core_vanishing_line(&camera, &ends);
}
static int32_t depth(void) { return gedepth_core_ground_depth(&ground, 80.0f, map_memory, (size_t)W * H); }

/* The pixel that takes most. */
static void measure_pixels(void) {
  uint32_t most = 0;
  for (uint32_t v = 0; v < H; v++)
    for (uint32_t u = 0; u < W; u++) {
      double inverse;
      uint32_t before = board_clock();
      gedepth_core_inverse_depth_at(&camera, u, v, &inverse);
      uint32_t count = board_elapsed(before);
      if (count > most) most = count;
    }
  print_number("inverse_depth_at: at most ", most);
  write_line(" instructions");
}

static gedepth_core_head residual, attention, slope;
static const gedepth_core_fusion settings = {GEDEPTH_CORE_HALF_PIXEL, 0.1f, 80.0f, 150.0f};
static const double radians[11] = {-0.085, -0.068, -0.051, -0.034, -0.017, 0.0, 0.017, 0.034, 0.051, 0.068, 0.085};
static const gedepth_core_slope_classes classes = {radians, 11, GEDEPTH_CORE_DOWNHILL_POSITIVE, 0};
static gedepth_core_maps maps;
static float scratch[GEDEPTH_CORE_SCRATCH_LEN(320, 96, 80, 11)], heads[13 * 80 * 24];

static int32_t baseline(void) {
  return gedepth_core_fuse_baseline(&settings, W, H, &residual, scratch, sizeof scratch / sizeof *scratch, map_memory,
                                    (size_t)W * H);
}
static int32_t vanilla(void) {
  return gedepth_core_fuse_vanilla(&settings, &ground, &residual, &attention, scratch, sizeof scratch / sizeof *scratch,
                                   &maps);
}
static int32_t adaptive(void) {
  return gedepth_core_fuse_adaptive(&settings, &ground, &residual, &attention, &slope, &classes, scratch,
                                    sizeof scratch / sizeof *scratch, &maps);
}

static gedepth_core_head head(uint32_t channels, uint32_t unit, uint32_t decode_at, const float *values) {
  gedepth_core_head made = {values,   channels * (W / 4) * (H / 4), GEDEPTH_CORE_F32, channels, W / 4, H / 4, unit,
                            decode_at, 0.0f, 0, 0.0f};
  return made;
}

static void measure_at(uint32_t width, uint32_t height) {
  /* The last but one in a wide picture: most pixels have no ray, and the search for one takes all its steps. */
  static const gedepth_core_lens lenses[4] = {
      {0, 0, GEDEPTH_CORE_PINHOLE, 0, 0, 0, 0, 0, 0, {0}},
      {0, 0, GEDEPTH_CORE_BROWN_CONRADY, 0, 0, 0, 0, 0, 0, {-0.28, 0.09, 1e-3, -5e-4, -0.012}},
      {0, 0, GEDEPTH_CORE_BROWN_CONRADY, 0, 0, 0, 0, 0, 0, {-0.28, 0.09, 1e-3, -5e-4, -0.012}},
      {0, 0, GEDEPTH_CORE_KANNALA_BRANDT, 0, 0, 0, 0, 0, 0, {-0.02, 4e-3, -1e-3, 1e-4}}};
  static const char *const names[4] = {"# pinhole", "# Brown-Conrady", "# Brown-Conrady, most pixels without a ray",
                                       "# Kannala-Brandt"};
  W = width;
  H = height;
  for (int i = 3; i >= 0; i--) {
    lens = lenses[i];
    lens.width = width;
    lens.height = height;
    lens.fx = lens.fy = (i == 2 ? 0.1 : 0.58) * width;
    lens.cx = 0.5 * width;
    lens.cy = 0.5 * height;
    write_line(names[i]);
    /* Without a fold the search for one goes to its end. */
    for (int k = 0; k < 8; k++) lens.coefficients[k] = 0.0;
    measure("set_lens, no fold", width, height, set_lens);
    for (int k = 0; k < 8; k++) lens.coefficients[k] = lenses[i].coefficients[k];
    measure("set_lens", width, height, set_lens);
    measure("set_mounting", width, height, set_mounting);
    measure("vanishing_line", width, height, line);
    if (width == 160) measure_pixels();
    measure("table_build", width, height, table);
    measure("ground_depth", width, height, depth);
    measure("table_build_metres", width, height, metres);
    measure("rays_build", width, height, rays);
    measure("table_rebuild", width, height, rebuild);
  }
  measure("table_build_rows", width, height, rows);
  measure("table_coefficients", width, height, coefficients);
  table();
  gedepth_core_maps wanted = {map_memory, (size_t)width * height, 0, 0, 0, 0};
  maps = wanted;
  noise(heads, sizeof heads / sizeof *heads, 1, 4.0f, -1.0f);
  size_t plane = (size_t)(width / 4) * (height / 4);
  for (uint32_t at = GEDEPTH_CORE_DECODE_AT_HEAD; at <= GEDEPTH_CORE_DECODE_AT_OUTPUT; at++) {
    write_line(at == GEDEPTH_CORE_DECODE_AT_HEAD ? "# decoded at the head's size" : "# decoded at the output's size");
    residual = head(1, GEDEPTH_CORE_LOG_METRES, at, heads);
    attention = head(1, GEDEPTH_CORE_LOGIT, at, heads + plane);
    slope = head(11, GEDEPTH_CORE_LOGIT, at, heads + 2 * plane);
    measure("fuse_baseline", width, height, baseline);
    measure("fuse_vanilla", width, height, vanilla);
    measure("fuse_adaptive", width, height, adaptive);
  }
}

_Noreturn void firmware(void) {
  int failed = vectors();
  if (failed) board_exit(1);
  write_line("-- measurements");
  measure_at(160, 48);
  measure_at(320, 96);
  print_number("memory: table (float) ", (uint32_t)(gedepth_core_table_len(320, 96) * sizeof(float)));
  print_number(" bytes, table (uint16_t) ", (uint32_t)(gedepth_core_table_len(320, 96) * sizeof(uint16_t)));
  print_number(" bytes, rows ", (uint32_t)(gedepth_core_rows_len(320, 96) * sizeof(float)));
  print_number(" bytes, rays ", (uint32_t)(gedepth_core_rays_len(320, 96) * sizeof(float)));
  print_number(" bytes, scratch ", (uint32_t)sizeof scratch);
  print_number(" bytes at 320x96; camera ", (uint32_t)sizeof camera);
  write_line(" bytes");
  board_exit(0);
}
