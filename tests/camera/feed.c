/* Feeds JPEG files to a v4l2loopback device, as a camera would: one file a frame, so many a second. It says on
 * stdout when it wrote which file. In C, since a program of one page that needs nothing is all the machine lacks. */
#include <errno.h>
#include <fcntl.h>
#include <linux/videodev2.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <time.h>
#include <unistd.h>

static char frame[4 << 20];

static void fail(const char *what) {
    fprintf(stderr, "feed: %s: %s\n", what, strerror(errno));
    exit(1);
}

static size_t read_frame(const char *path) {
    FILE *file = fopen(path, "rb");
    if (!file) fail(path);
    size_t length = fread(frame, 1, sizeof frame, file);
    fclose(file);
    return length;
}

/* Width and height as the JPEG says, in the segment that begins its frame. */
static void read_size(size_t length, struct v4l2_pix_format *pix) {
    const unsigned char *bytes = (const unsigned char *)frame;
    for (size_t at = 2; at + 9 < length && bytes[at] == 0xff; at += 2 + (bytes[at + 2] << 8 | bytes[at + 3])) {
        if (bytes[at + 1] >= 0xc0 && bytes[at + 1] <= 0xc2) {
            pix->height = bytes[at + 5] << 8 | bytes[at + 6];
            pix->width = bytes[at + 7] << 8 | bytes[at + 8];
            return;
        }
    }
    fprintf(stderr, "feed: the first file is no JPEG\n");
    exit(1);
}

int main(int count, char **arguments) {
    if (count < 4) {
        fprintf(stderr, "usage: feed DEVICE FRAMES_A_SECOND FILE...\n");
        return 2;
    }
    const char *device = arguments[1];
    long interval_nanos = 1000000000L / atol(arguments[2]);
    int camera = open(device, O_WRONLY);
    if (camera < 0) fail(device);
    struct v4l2_format format = {.type = V4L2_BUF_TYPE_VIDEO_OUTPUT};
    read_size(read_frame(arguments[3]), &format.fmt.pix);
    format.fmt.pix.pixelformat = V4L2_PIX_FMT_MJPEG;
    format.fmt.pix.sizeimage = sizeof frame;
    format.fmt.pix.field = V4L2_FIELD_NONE;
    if (ioctl(camera, VIDIOC_S_FMT, &format) < 0) fail("VIDIOC_S_FMT");
    struct timespec due;
    clock_gettime(CLOCK_MONOTONIC, &due);
    for (int i = 3; i < count; i++) {
        size_t length = read_frame(arguments[i]);
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        struct timespec now;
        clock_gettime(CLOCK_REALTIME, &now);
        if (write(camera, frame, length) != (ssize_t)length) fail("write");
        printf("%lld.%06ld %s\n", (long long)now.tv_sec, now.tv_nsec / 1000, arguments[i]);
        fflush(stdout);
        due.tv_nsec += interval_nanos;
        due.tv_sec += due.tv_nsec / 1000000000L;
        due.tv_nsec %= 1000000000L;
    }
    return 0;
}
