/* The joints of a robot by Cyclone DDS of Debian, C: publisher ANGLES RATE SECONDS [AHEAD]. ANGLES: rows of six doubles,
   rad; its clock is AHEAD of this machine's (s). The type's code beside this file was generated: idlc JointState.idl */
#include "JointState.h"
#include "dds/dds.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#define JOINTS 6
#define NS 1000000000LL

static sensor_msgs_msg_dds__JointState_ message;
static char *names[JOINTS] = {"m1", "m2", "m3", "l1", "l2", "l3"};

static long long now(clockid_t clock) {
  struct timespec t;
  clock_gettime(clock, &t);
  return t.tv_sec * NS + t.tv_nsec;
}

static double *rows_of(const char *path, long *rows) {
  FILE *file = fopen(path, "rb");
  if (!file) exit(2);
  fseek(file, 0, SEEK_END);
  *rows = ftell(file) / (long)(JOINTS * sizeof(double));
  rewind(file);
  double *values = malloc((size_t)*rows * JOINTS * sizeof(double));
  if (fread(values, JOINTS * sizeof(double), (size_t)*rows, file) != (size_t)*rows) exit(2);
  fclose(file);
  return values;
}

int main(int argc, char **argv) {
  if (argc < 4) return 2;
  long rows, period = (long)(1e9 / atof(argv[2])), n = (long)(atof(argv[2]) * atof(argv[3]));
  double *angles = rows_of(argv[1], &rows);
  const char *domain = getenv("ROS_DOMAIN_ID");
  dds_entity_t robot = dds_create_participant(domain ? (dds_domainid_t)atoi(domain) : 0, NULL, NULL);
  dds_entity_t topic = dds_create_topic(robot, &sensor_msgs_msg_dds__JointState__desc, "rt/joint_states", NULL, NULL);
  dds_qos_t *qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 10);
  dds_entity_t writer = dds_create_writer(robot, topic, qos, NULL);
  dds_publication_matched_status_t status = {0};
  while (!status.current_count) {
    dds_sleepfor(DDS_MSECS(10));
    dds_get_publication_matched_status(writer, &status);
  }
  dds_sleepfor(DDS_MSECS(300));
  message.header.frame_id = "base";
  message.name._buffer = names;
  message.name._length = message.name._maximum = JOINTS;
  message.position._length = message.position._maximum = JOINTS;
  long long begun = now(CLOCK_MONOTONIC), since = now(CLOCK_REALTIME);
  if (argc > 4) since += (long long)(atof(argv[4]) * NS);
  for (long k = 0; k < n; ++k) {
    long long due = begun + k * period, stamp = since + k * period;
    struct timespec until = {due / NS, due % NS};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
    message.header.stamp.sec = (int)(stamp / NS);
    message.header.stamp.nanosec = (unsigned)(stamp % NS);
    message.position._buffer = angles + k % rows * JOINTS;
    dds_write(writer, &message);
  }
  dds_sleepfor(DDS_MSECS(1000));
  printf("%ld\n", n);
  return 0;
}
