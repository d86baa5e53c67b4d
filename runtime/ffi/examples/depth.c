/*
 * From a picture and its calibration to a depth map:
 *
 *   depth PICTURE.ppm CALIBRATION DEPTH.pgm [KERNEL]
 *
 * The picture is a binary PPM (`pngtopnm image.png >image.ppm`), the depth a 16-bit PGM: metres x 256, 0 is none, as
 * `gedepth run` writes it into depth.png. KERNEL is one of GEDEPTH_KERNEL_*, as a number; 0 is the best.
 */
#include <gedepth.h>

#include <stdio.h>
#include <stdlib.h>

/* A binary PPM of 8 bits; NULL if it is none. */
static uint8_t *read_ppm(const char *path, uint32_t *width, uint32_t *height) {
  FILE *file = fopen(path, "rb");
  uint8_t *rgb = NULL;
  unsigned w = 0, h = 0, greatest = 0;
  if (file == NULL) return NULL;
  if (fscanf(file, "P6 %u %u %u", &w, &h, &greatest) == 3 && greatest == 255 && w >= 1 && h >= 1 && w <= 16384 &&
      h <= 16384 && getc(file) != EOF) {
    const size_t bytes = 3 * (size_t)w * h;
    rgb = malloc(bytes);
    if (rgb != NULL && fread(rgb, 1, bytes, file) != bytes) {
      free(rgb);
      rgb = NULL;
    }
  }
  fclose(file);
  *width = w;
  *height = h;
  return rgb;
}

/* Metres x 256 to the nearest, the greater byte first. */
static int write_pgm(const char *path, const float *depth, uint32_t width, uint32_t height) {
  FILE *file = fopen(path, "wb");
  size_t i;
  int written;
  if (file == NULL) return 0;
  written = fprintf(file, "P5\n%u %u\n65535\n", (unsigned)width, (unsigned)height) > 0;
  for (i = 0; i < (size_t)width * height && written; i++) {
    const float scaled = depth[i] * 256.0F + 0.5F;
    const unsigned value = scaled < 65535.0F ? (unsigned)scaled : 65535U;
    written = putc((int)(value >> 8), file) != EOF && putc((int)(value & 255U), file) != EOF;
  }
  return fclose(file) == 0 && written;
}

int main(int arguments, char **argument) {
  gedepth_calibration calibration;
  gedepth_model *model = NULL;
  gedepth_camera *camera = NULL;
  gedepth_picture picture = {0};
  gedepth_maps maps = {0};
  gedepth_shape shape;
  gedepth_times times;
  gedepth_statistics statistics;
  uint8_t *rgb = NULL;
  int run, status = EXIT_FAILURE;

  if (arguments < 4 || arguments > 5) {
    fprintf(stderr, "usage: %s PICTURE.ppm CALIBRATION DEPTH.pgm [KERNEL]\n", argument[0]);
    return 2;
  }
  if (gedepth_abi_version() != GEDEPTH_ABI_VERSION) {
    fprintf(stderr, "this library is another version than its header\n");
    return EXIT_FAILURE;
  }
  rgb = read_ppm(argument[1], &picture.width, &picture.height);
  if (rgb == NULL) {
    fprintf(stderr, "%s: not a binary PPM of 8 bits\n", argument[1]);
    return EXIT_FAILURE;
  }
  picture.bytes = rgb;
  picture.bytes_len = 3 * (size_t)picture.width * picture.height;

  /* Once. */
  if (gedepth_calibration_read(argument[2], &calibration) != GEDEPTH_OK) goto failed;
  if (calibration.width == 0) { /* the file does not say */
    calibration.width = picture.width;
    calibration.height = picture.height;
  }
  if (gedepth_model_open_embedded(arguments > 4 ? (uint32_t)atoi(argument[4]) : GEDEPTH_KERNEL_BEST, 0, &model) !=
      GEDEPTH_OK)
    goto failed;
  if (gedepth_camera_open(model, &calibration, NULL, &camera) != GEDEPTH_OK) goto failed;
  if (gedepth_camera_shape(camera, &shape) != GEDEPTH_OK) goto failed;
  maps.depth.values_len = (size_t)shape.map_width * shape.map_height;
  maps.depth.values = malloc(maps.depth.values_len * sizeof(float));
  if (maps.depth.values == NULL) {
    fprintf(stderr, "no memory\n");
    goto closed;
  }

  /* For every picture; here for the same one, thrice. */
  for (run = 0; run < 3; run++) {
    const int32_t result = gedepth_camera_run(camera, &picture, &maps, 100000000, &times);
    if (result == GEDEPTH_DEADLINE) {
      fprintf(stderr, "late: %s\n", gedepth_last_error()); /* the depth is complete all the same */
    } else if (result != GEDEPTH_OK) {
      goto failed;
    }
  }
  if (gedepth_camera_statistics(camera, &statistics) != GEDEPTH_OK) goto failed;
  printf("depth %u x %u, network %u x %u; %.2f ms (preprocess %.2f, network %.2f, fusion %.2f, copy %.2f), at most %.2f\n",
         (unsigned)shape.map_width, (unsigned)shape.map_height, (unsigned)shape.network_width,
         (unsigned)shape.network_height, (double)times.total_ns * 1e-6, (double)times.preprocess_ns * 1e-6,
         (double)times.network_ns * 1e-6, (double)times.fusion_ns * 1e-6, (double)times.copy_ns * 1e-6,
         (double)statistics.total.max_ns * 1e-6);
  if (!write_pgm(argument[3], maps.depth.values, shape.map_width, shape.map_height)) {
    fprintf(stderr, "%s: cannot write\n", argument[3]);
    goto closed;
  }
  status = EXIT_SUCCESS;
  goto closed;

failed:
  fprintf(stderr, "%s\n", gedepth_last_error());
closed:
  free(maps.depth.values);
  free(rgb);
  gedepth_camera_close(camera);
  gedepth_model_close(model);
  return status;
}
