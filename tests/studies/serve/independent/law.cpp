// Another controller in C++ with Debian's Fast DDS, as rmw_fastrtps talks: the paper's law of fmus/parts/paper_law, and
// kinematics, Jacobian and statics of its own.
//
//     law ROBOT PERIOD
//
// ROBOT: a file of lines "name value", SI: a b l_a l_b m_a m_b m_p k_s N eta dead_zone; "way t x y z" for each way point;
// "law" and the value of each variable of paper_law, in the order of part.toml. Each sample of /joint_states is answered
// on /robot_joint_command with its stamp; PERIOD (s) is the time between two samples.
#include "JointStatePubSubTypes.h"
extern "C" {
#include "model.h"
}

#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fstream>
#include <map>
#include <string>
#include <vector>

using namespace eprosima::fastdds::dds;
using Message = sensor_msgs::msg::dds_::JointState_;
using Vector = std::array<double, 3>;

static double dot(const Vector &a, const Vector &b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

struct Robot {
    std::map<std::string, double> of;
    std::vector<std::array<double, 4>> way;
    Vector p{0.0, 0.0, -0.1}; // the last pose begins the search for the next

    double operator[](const char *name) const { return of.at(name); }

    static Vector outward(int leg)
    {
        const double phi = (-90.0 + 120.0 * leg) * std::acos(-1.0) / 180.0;
        return {std::cos(phi), std::sin(phi), 0.0};
    }

    // From the knee A_i to the platform's joint P_i.
    Vector distal(int leg, double theta, const Vector &at) const
    {
        const Vector e = outward(leg);
        const Robot &r = *this;
        const double radial = r["b"] - r["a"] - r["l_a"] * std::cos(theta);
        return {at[0] + radial * e[0], at[1] + radial * e[1], at[2] + r["l_a"] * std::sin(theta)};
    }

    // Solve M x = y by Cramer's rule.
    static Vector solve(const Vector M[3], const Vector &y)
    {
        const auto det = [](const Vector &a, const Vector &b, const Vector &c) {
            return a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) +
                   a[2] * (b[0] * c[1] - b[1] * c[0]);
        };
        const double whole = det(M[0], M[1], M[2]);
        Vector x;
        for (int k = 0; k < 3; k++) {
            Vector N[3] = {M[0], M[1], M[2]};
            for (int i = 0; i < 3; i++)
                N[i][k] = y[i];
            x[k] = det(N[0], N[1], N[2]) / whole;
        }
        return x;
    }

    // Forward kinematics: Newton's method on |A_iP_i| = l_b, Eq. 7.
    void move(const Vector &theta)
    {
        const double l_b = (*this)["l_b"];
        for (int turn = 0; turn < 50; turn++) {
            Vector rows[3], rest;
            for (int i = 0; i < 3; i++) {
                rows[i] = distal(i, theta[i], p);
                rest[i] = 0.5 * (l_b * l_b - dot(rows[i], rows[i]));
            }
            const Vector step = solve(rows, rest);
            for (int i = 0; i < 3; i++)
                p[i] += step[i];
            if (dot(step, step) < 1e-34)
                return;
        }
    }

    // What the law is given: pose, Jacobian, spring torques and force of the encoders' angles.
    void estimate(const Vector &theta_m, const Vector &theta_l, Variables &v)
    {
        const Robot &r = *this;
        move(theta_l);
        const double g = 9.81, weight = (r["m_p"] + 1.5 * r["m_b"]) * g, arm = 0.5 * (r["m_a"] + r["m_b"]) * g;
        Vector force{0.0, 0.0, -weight};
        for (int i = 0; i < 3; i++) {
            const Vector e = outward(i), s = distal(i, theta_l[i], p);
            const double sine = std::sin(theta_l[i]), cosine = std::cos(theta_l[i]);
            const Vector d{-r["l_a"] * sine * e[0], -r["l_a"] * sine * e[1], -r["l_a"] * cosine};
            double turned = theta_m[i] - r["N"] * theta_l[i];
            const double slack = r["dead_zone"];
            turned = turned > slack ? turned - slack : turned < -slack ? turned + slack : 0.0;
            const double tau = r["k_s"] * r["N"] * r["eta"] * turned;
            (&v.tau_l_1)[i] = tau;
            for (int k = 0; k < 3; k++) {
                const double J = s[k] / dot(s, d);
                (&v.J_1)[3 * i + k] = J;
                force[k] += J * (tau + arm * r["l_a"] * cosine);
            }
        }
        for (int k = 0; k < 3; k++)
            (&v.p_B_1)[k] = p[k], (&v.F_ee_B_1)[k] = force[k];
    }

    // The way points at t, straight lines between them.
    void lead(double t, Variables &v) const
    {
        if (way.empty())
            return;
        std::size_t k = 0;
        while (k + 1 < way.size() && t >= way[k + 1][0])
            k++;
        const auto &from = way[k], &to = way[k + 1 < way.size() ? k + 1 : k];
        const double share = to[0] > from[0] && t > from[0] ? (t - from[0]) / (to[0] - from[0]) : 0.0;
        for (int i = 0; i < 3; i++)
            (&v.way_1)[i] = from[1 + i] + share * (to[1 + i] - from[1 + i]);
    }
};

static double angle_of(const Message &message, const std::string &joint)
{
    for (std::size_t k = 0; k < message.name().size(); k++)
        if (message.name()[k] == joint)
            return message.position().at(k);
    std::fprintf(stderr, "no joint %s\n", joint.c_str());
    std::exit(1);
}

int main(int n_words, char **words)
{
    if (n_words < 3)
        return 2;
    Robot robot;
    static Variables law;
    std::ifstream file(words[1]);
    for (std::string name; file >> name;) {
        if (name == "way") {
            std::array<double, 4> point;
            for (double &x : point)
                file >> x;
            robot.way.push_back(point);
            continue;
        }
        if (name == "law")
            for (double &x : law.at)
                file >> x;
        else
            file >> robot.of[name];
    }
    const double period = std::atof(words[2]);

    const char *domain = std::getenv("ROS_DOMAIN_ID");
    auto *factory = DomainParticipantFactory::get_instance();
    auto *node = factory->create_participant(domain ? std::atoi(domain) : 0, PARTICIPANT_QOS_DEFAULT);
    auto *support = new sensor_msgs::msg::dds_::JointState_PubSubType();
    support->auto_fill_type_object(false);
    support->auto_fill_type_information(false);
    TypeSupport type(support);
    type.register_type(node);
    auto *states = node->create_topic("rt/joint_states", type.get_type_name(), TOPIC_QOS_DEFAULT);
    auto *commands = node->create_topic("rt/robot_joint_command", type.get_type_name(), TOPIC_QOS_DEFAULT);
    const auto realloc = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    DataWriterQos out = DATAWRITER_QOS_DEFAULT;
    out.reliability().kind = RELIABLE_RELIABILITY_QOS;
    out.durability().kind = VOLATILE_DURABILITY_QOS;
    out.history().depth = 100;
    out.endpoint().history_memory_policy = realloc;
    DataReaderQos in = DATAREADER_QOS_DEFAULT;
    in.reliability().kind = RELIABLE_RELIABILITY_QOS;
    in.history().depth = 100;
    in.endpoint().history_memory_policy = realloc;
    auto *writer = node->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(commands, out);
    auto *reader = node->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(states, in);

    Message sample, reply;
    reply.name({"m1", "m2", "m3"});
    reply.velocity(std::vector<double>(3, 0.0));
    long samples = 0, again = 0;
    long long newest = 0;
    bool met = false;
    for (;;) {
        reader->wait_for_unread_message(eprosima::fastrtps::Duration_t(0.1));
        for (SampleInfo info; reader->take_next_sample(&sample, &info) == ReturnCode_t::RETCODE_OK;) {
            if (!info.valid_data)
                continue;
            const auto &stamp = sample.header().stamp();
            const long long ns = stamp.sec() * 1000000000LL + stamp.nanosec();
            if (ns > newest) {
                newest = ns;
                Vector theta_m, theta_l;
                for (int i = 0; i < 3; i++) {
                    theta_m[i] = angle_of(sample, "m" + std::to_string(i + 1));
                    theta_l[i] = angle_of(sample, "l" + std::to_string(i + 1));
                }
                robot.estimate(theta_m, theta_l, law);
                robot.lead(double(samples) * period, law);
                if (!model_step(&law, period))
                    return 1;
                samples++;
                reply.velocity({law.omega_ref_1, law.omega_ref_2, law.omega_ref_3});
            } else
                again++;
            reply.header().stamp() = stamp;
            writer->write(&reply);
        }
        SubscriptionMatchedStatus status;
        reader->get_subscription_matched_status(status);
        met = met || status.current_count > 0;
        if (met && status.current_count == 0)
            break;
    }
    std::printf("%ld %ld %ld\n", samples, samples, again);
}
