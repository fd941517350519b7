/* x of a mirror mount by five steps. cc mount.c -o mount; ./mount /dev/ttyACM0  (docs/other-programs.md) */
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

static char answer[128];

/* Send a line. Return the line that answers it, "" if none comes within 2 s. */
static const char *ask(int port, const char *line) {
  size_t n = 0;
  if (write(port, line, strlen(line)) < 0) perror("write");
  while (n < sizeof answer - 1 && read(port, answer + n, 1) == 1 && answer[n] != '\n') n++;
  answer[n ? n - 1 : 0] = 0; /* without its CR */
  return answer;
}

int main(int argc, char **argv) {
  struct termios raw;
  int port = open(argc > 1 ? argv[1] : "no port", O_RDWR | O_NOCTTY), early;
  if (port < 0 || tcgetattr(port, &raw)) { perror("port"); return 1; }
  cfmakeraw(&raw); /* no echo, and no line end is changed */
  cfsetspeed(&raw, B115200);
  raw.c_cc[VMIN] = 0, raw.c_cc[VTIME] = 20; /* tenths of a second that a read waits */
  tcsetattr(port, TCSANOW, &raw);
  puts(ask(port, "*IDN?\n"));
  if (write(port, "XK500;2PR5\n", 11) < 0) perror("write");
  while (*ask(port, "2MD?\n") == '0') usleep(100000); /* each question keeps the move alive */
  puts(ask(port, "2TP?\n"));
  early = strncmp(ask(port, "2XE?\n"), "1,", 2); /* reason 1: done */
  if (early) fprintf(stderr, "it ended early: %s\n", answer);
  return write(port, "!\n", 2) < 0 || early;
}
