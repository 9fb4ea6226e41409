/* The display as a device of CHAI3D: coulombus_world.h in a class that derives from cGenericHapticDevice.
 *
 * CHAI3D moves a point in space and computes a force in each of its steps. The display has one axis and takes
 * no forces: it renders a local model (docs/worlds.md). So this class translates.
 *
 * - The handle moves along CHAI3D's y axis: y = radius_m * angle. x and z are 0, and their forces have no effect,
 *   as have torques and the gripper's force.
 * - A force becomes a wall with the stiffness `K_N_m`, at the place where the wall exerts this force now. For an
 *   object of this stiffness the wall is the object's surface, and stays there while the handle moves.
 *   So set `K_N_m` to the stiffness of the objects (cMaterial::setStiffness).
 * - A wall never pulls. What is no surface (magnets, viscosity, vibration) is displayed as far as a wall can.
 * - Each state of the host (1 kHz) gets one model: setForce waits for the next state, and so paces CHAI3D's loop.
 *
 *     cCoulombusDevicePtr device = std::make_shared<cCoulombusDevice>("bench", 0.1, 200.0);
 *     if (!device->open()) return 1;
 *     tool->setHapticDevice(device);
 *
 * The law of the rig is off meanwhile (`law` below). One thread uses a device at a time. Linux, C++17.
 */
#ifndef COULOMBUS_CHAI3D_DEVICE_H
#define COULOMBUS_CHAI3D_DEVICE_H

#include <memory>
#include <string>
#include <poll.h>
#include "chai3d.h"
#include "coulombus_world.h"

class cCoulombusDevice : public chai3d::cGenericHapticDevice {
public:
    double law = 0.0; /* share of the rig's friction beside the wall, 0 to 1 */

    cCoulombusDevice(std::string bus, double radius_m, double K_N_m, std::string key = "")
        : bus_(bus), key_(key), radius_m_(radius_m), K_N_m_(K_N_m) {
        m_deviceReady = false;
        m_deviceAvailable = true;
        m_specifications.m_model = chai3d::C_HAPTIC_DEVICE_CUSTOM;
        m_specifications.m_manufacturerName = "Coulombus";
        m_specifications.m_modelName = bus;
        m_specifications.m_maxLinearStiffness = K_N_m;
        m_specifications.m_workspaceRadius = 3.14 * radius_m; /* half a turn to each side */
        m_specifications.m_sensedPosition = m_specifications.m_actuatedPosition = true;
        m_specifications.m_sensedRotation = m_specifications.m_actuatedRotation = false;
        m_specifications.m_sensedGripper = m_specifications.m_actuatedGripper = false;
        m_specifications.m_leftHand = m_specifications.m_rightHand = true;
    }

    virtual ~cCoulombusDevice() { close(); }

    /* Connect, and wait for the first state. */
    bool open() override {
        if (m_deviceReady) return true;
        if (coulombus_connect(&world_, bus_.c_str(), key_.c_str()) != 0) {
            perror(bus_.c_str());
            return false;
        }
        m_deviceReady = true;
        state_.sequence = -1;
        while (m_deviceReady && state_.sequence < 0) take();
        return m_deviceReady;
    }

    bool close() override {
        if (m_deviceReady) ::close(world_.fd);
        m_deviceReady = false;
        return true;
    }

    bool calibrate(bool = false) override { return m_deviceReady; }

    bool getPosition(chai3d::cVector3d &position) override {
        update();
        position.set(0.0, m_deviceReady ? radius_m_ * state_.x_rad : 0.0, 0.0);
        return m_deviceReady;
    }

    /* Of the state of getPosition. */
    bool getLinearVelocity(chai3d::cVector3d &velocity) override {
        velocity.set(0.0, m_deviceReady ? radius_m_ * state_.v_rad_s : 0.0, 0.0);
        return m_deviceReady;
    }

    bool setForceAndTorqueAndGripperForce(
        const chai3d::cVector3d &force, const chai3d::cVector3d &torque, const double gripper_force) override {
        m_prevForce = force;
        m_prevTorque = torque;
        m_prevGripperForce = gripper_force;
        struct coulombus_model model = model_of(force.y());
        const int64_t sequence = state_.sequence;
        if (m_deviceReady && coulombus_render(&world_, &model) != 0) close();
        while (m_deviceReady && state_.sequence == sequence) take();
        return m_deviceReady;
    }

private:
    std::string bus_, key_;
    double radius_m_, K_N_m_;
    struct coulombus_world world_;
    struct coulombus_state state_ = {}; /* CHAI3D's force is that at its position */

    struct coulombus_model model_of(double force_N) const {
        struct coulombus_model model = coulombus_model(0.1);
        model.law = law;
        if (force_N == 0.0) return model;
        model.parts = COULOMBUS_WALL;
        model.wall_side = force_N < 0.0 ? 1 : -1;
        model.wall_K_Nm_rad = K_N_m_ * radius_m_ * radius_m_;
        model.wall_x_rad = state_.x_rad + force_N * radius_m_ / model.wall_K_Nm_rad;
        return model;
    }

    /* Take all states that have arrived. */
    void update() {
        struct pollfd arrived = {world_.fd, POLLIN, 0};
        while (m_deviceReady && poll(&arrived, 1, 0) > 0) take();
    }

    /* Wait for a record; close at the host's end, and where another program has control. */
    void take() {
        union coulombus_record record;
        if (coulombus_next(&world_, &record) != 0) {
            close();
        } else if (record.head.kind == COULOMBUS_STATE && record.state.axis == 0) {
            state_ = record.state;
        } else if (record.head.kind == COULOMBUS_REFUSED && !record.refused.again) {
            fprintf(stderr, "%s: %.232s\n", bus_.c_str(), record.refused.reason);
            close();
        }
    }
};

typedef std::shared_ptr<cCoulombusDevice> cCoulombusDevicePtr;

#endif
